"""Errors of boxes and positions that last, learned from innovations: of bodies, poses, clocks and sources."""
