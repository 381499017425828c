"""Balls that look similar, rendered for several cameras."""
