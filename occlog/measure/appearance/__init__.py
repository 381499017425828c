"""Verb: learn appearance by viewing direction, and identify boxes by it."""
