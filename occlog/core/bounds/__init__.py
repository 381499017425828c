"""Cramér-Rao bounds of positions, in the plane and in space."""
