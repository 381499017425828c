"""Verb: predict the errors of sensors over the floor, and rank further placements."""
