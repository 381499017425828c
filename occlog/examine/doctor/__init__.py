"""Searches for everything that is wrong in files, and states all of it."""
