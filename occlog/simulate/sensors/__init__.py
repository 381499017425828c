"""Measurements of simulated targets by cameras and microphone arrays."""
