"""Motion of targets and occluders: random waypoints, scripted paths, a room of people."""
