"""Verb: make a packed run again, and state whether it is the same."""
