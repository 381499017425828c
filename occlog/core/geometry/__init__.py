"""Cameras, sight lines and where they meet, fundamental matrices."""
