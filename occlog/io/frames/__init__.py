"""Frames of video and images, decoded in a their own process."""
