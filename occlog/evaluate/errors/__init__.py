"""Errors of tracks on the ground and in space, beside their bound."""
