"""A shift's work on a fleet: which sensors, which steps, what was done before, what came out."""
