"""Verbs that make measurements of images and sound, and what they share."""
