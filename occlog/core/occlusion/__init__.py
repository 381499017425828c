"""P(hidden): the probability that moving occluders hide a place from a camera."""
