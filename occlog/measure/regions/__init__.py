"""Foreground of an image: background model, connected regions, their appearance."""
