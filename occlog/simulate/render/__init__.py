"""Rendering of video of walking people in a room, by ray casting."""
