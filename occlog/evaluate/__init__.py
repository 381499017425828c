"""Verb: compare tracks with the truth and with the Cramér-Rao bound."""
