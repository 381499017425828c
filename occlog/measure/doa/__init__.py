"""Verb: find directions of arrival in the sound of microphone arrays."""
