"""Sight lines of several cameras, and the decision by likelihood ratio."""
