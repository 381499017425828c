"""Fusion of tracks of several groups of cameras: one identity and one state per person."""
