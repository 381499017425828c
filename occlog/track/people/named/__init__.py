"""Tracks of everybody under the identities of a gallery of how people look."""
