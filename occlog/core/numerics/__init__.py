"""Compilation, seeds, assignment, interpolation, special functions."""
