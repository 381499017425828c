"""Everybody in the image of a camera."""
