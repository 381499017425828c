"""Verb: bring tracks in the images of calibrated cameras together in the world."""
