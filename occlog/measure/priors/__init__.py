"""Verb: find where moving occluders are, from views, positions or sound."""
