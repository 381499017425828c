"""Likelihoods and resampling of particles in space."""
