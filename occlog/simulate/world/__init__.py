"""How targets and occluders move: random waypoints, scripted paths, a room of people."""
