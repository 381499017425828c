"""Comparison of two runs by time step: matching of tracks, distances from the truth, divergences."""
