"""Policies out of racerl and onto cars: files that other programs run."""
