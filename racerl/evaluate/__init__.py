"""Racing a controller and scoring its laps."""
