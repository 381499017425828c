"""Pairs estimates and measurements with true targets."""
