"""Replay: the time steps of a run, for scrubbing and playing in the page."""
