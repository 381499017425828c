"""Simulation of similar balls, rendered for several cameras."""
