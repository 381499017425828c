"""Directions of arrival from the sound of microphone arrays."""
