"""P(hidden): the probability that moving occluders hide a position from a camera."""
