"""Frames of all cameras in step, tracked and written."""
