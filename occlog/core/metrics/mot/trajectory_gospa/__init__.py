"""Trajectory GOSPA: a distance between sets of trajectories, and the linear programs that it is found by."""
