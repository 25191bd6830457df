"""Tells Gymnasium about the race; imported with racerl, so it imports nothing heavy itself."""

ENVIRONMENT = "racerl/Race-v0"


def register() -> None:
    """Register `racerl/Race-v0` for `gymnasium.make` and `gymnasium.make_vec`; once is enough."""
    from gymnasium.envs import registration

    if ENVIRONMENT not in registration.registry:
        registration.register(
            id=ENVIRONMENT,
            entry_point="racerl.config:make_env",
            vector_entry_point="racerl.config:make_vector_env",
        )
