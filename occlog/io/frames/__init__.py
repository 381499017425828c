"""Frames of video and images, decoded in a process of their own."""
