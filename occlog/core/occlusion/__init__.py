"""Probability that moving occluders hide a position from a camera."""
