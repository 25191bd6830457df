"""Training a policy: PPO or imitation, then an ascent or an evolution strategy; `racerl gap close`."""
