"""Balls that look alike, rendered for several cameras."""
