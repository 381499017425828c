"""Method `fix`: each position from the bearings of one time step."""
