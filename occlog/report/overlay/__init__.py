"""Tracks in images drawn over the video of all cameras."""
