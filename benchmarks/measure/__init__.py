"""Benchmarks: detection and priors."""
