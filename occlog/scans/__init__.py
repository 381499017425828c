"""Rows of one moment: what all sensors say at one time, and priors of occluders beside it."""
