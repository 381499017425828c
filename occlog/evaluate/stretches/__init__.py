"""Tracks, views and bearings in stretches of time, in memory that does not grow with a recording."""
