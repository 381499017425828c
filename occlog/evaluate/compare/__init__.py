"""Comparison of runs: paired comparisons of several tables of tracks with the same truth."""
