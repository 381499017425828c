"""Drawings in the world and over images: people, sensors, lines of sight, static objects."""
