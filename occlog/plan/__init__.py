"""Verb: tell what errors are to be expected of sensors, where, and which placements would help most."""
