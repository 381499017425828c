"""Verb: give candidates the identity of the track they agree with."""
