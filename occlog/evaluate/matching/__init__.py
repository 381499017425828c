"""Matching of estimates and measurements with true targets."""
