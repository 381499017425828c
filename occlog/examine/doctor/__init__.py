"""Looks for everything that is wrong in files, and says all of it."""
