"""Boxes of detectors: CSV, JSON, MOTChallenge."""
