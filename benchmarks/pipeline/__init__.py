"""Benchmarks: whole runs: memory, sweeps."""
