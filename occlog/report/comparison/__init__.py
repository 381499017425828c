"""Comparison of two runs: whether they differ, where they first diverge, and identity changes."""
