"""Drivers: the loops that feed a method scan by scan, block by block, or all targets at once."""
