"""Verb: list installed plug-ins, and check that they keep what the interface promises."""
