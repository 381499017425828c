"""Labelling of candidates with the identity of the track that they agree with."""
