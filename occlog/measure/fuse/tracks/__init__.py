"""Tracks of several groups of cameras brought together: one identity and one state of each person."""
