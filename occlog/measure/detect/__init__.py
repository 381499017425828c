"""Verb: reduce the frames of a recording to bearings."""
