"""Verbs: report what a file holds, what its columns mean, and whether two outputs are the same."""
