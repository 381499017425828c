"""Verb: find how pairs of views see the same point, or check it."""
