"""Residuals and sums from which lasting errors are learned."""
