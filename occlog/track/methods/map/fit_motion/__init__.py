"""Verb: identify a motion model from trajectories, by EM."""
