"""Benchmarks: kernels of the core."""
