"""Verb: do the stages of a run for each of many recordings, and collect their results in tables over all."""
