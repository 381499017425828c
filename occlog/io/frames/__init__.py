"""Frames of video and images, decoded in separate processes."""
