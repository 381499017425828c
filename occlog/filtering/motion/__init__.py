"""Motion models: constant velocity with noise, turns, motion in space."""
