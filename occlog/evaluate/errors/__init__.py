"""Errors of tracks on the ground and in space, with their bound."""
