"""Drive logs: what a car did, channel by channel, and where such logs come from."""
