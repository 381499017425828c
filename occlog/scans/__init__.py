"""Rows of one time step: measurements of all sensors at one time, and priors of occluders."""
