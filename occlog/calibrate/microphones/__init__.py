"""Poses and clocks of microphone arrays, from directions of people who walk."""
