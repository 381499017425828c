"""Benchmarks: tracking in images."""
