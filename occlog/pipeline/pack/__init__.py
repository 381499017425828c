"""Verb: put a run folder with its inputs and versions into one file."""
