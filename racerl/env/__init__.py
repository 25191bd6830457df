"""Racing as a batched environment: many cars on one track, one tensor operation for all."""
