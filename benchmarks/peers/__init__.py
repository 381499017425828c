"""Benchmarks: other projects on the same problems."""
