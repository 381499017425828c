"""Verb: estimate tracks; one folder a method, and the drivers that feed them."""
