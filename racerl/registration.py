"""Tells Gymnasium about the race; called when racerl is imported, so it imports nothing heavy itself."""


def register() -> None:
    """Register `racerl/Race-v0` for `gymnasium.make` and `gymnasium.make_vec`."""
    from gymnasium.envs.registration import register as register_environment

    register_environment(
        id="racerl/Race-v0",
        entry_point="racerl.config:make_env",
        vector_entry_point="racerl.config:make_vector_env",
    )
