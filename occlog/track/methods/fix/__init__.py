"""Method `fix`: each position from the bearings of one moment."""
