"""Verb: do the stages of a run for each of many recordings, and gather what comes out in tables over all."""
