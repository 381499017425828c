"""Cameras, lines of sight and where they meet, fundamental matrices."""
