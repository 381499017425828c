"""Batch processing of a recording or a sliding window: MCMC data association and smoothing."""
