"""Verb: do all stages of a configuration into a run folder."""
