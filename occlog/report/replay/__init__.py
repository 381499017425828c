"""The time steps of a run, to be scrubbed and played in the page."""
