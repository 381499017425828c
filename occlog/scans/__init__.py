"""Rows of one time step: what all sensors say at one time, and priors of occluders beside it."""
