"""Measurement from images and sound, and shared parts."""
