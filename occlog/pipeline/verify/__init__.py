"""Verb: make a packed run again, and say whether it is the same."""
