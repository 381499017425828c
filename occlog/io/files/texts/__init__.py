"""Texts and text tables, as values."""
