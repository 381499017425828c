"""Verb: do the stages of a run for each of many recordings, and collect what comes out in tables over all."""
