"""Verb: learn path losses, shadowing and coverage of readers from reads of tags at known positions."""
