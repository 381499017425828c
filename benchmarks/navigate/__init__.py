"""Benchmarks: robots on their way."""
