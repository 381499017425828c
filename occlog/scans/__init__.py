"""Scans: measurements of all sensors at one time step, and priors of occluders."""
