"""Polygons, the floor of a room and what stands on it."""
