"""Whether runs differ: paired comparisons of several tables of tracks with the same truth."""
