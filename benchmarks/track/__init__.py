"""Benchmarks: filters and trajectories."""
