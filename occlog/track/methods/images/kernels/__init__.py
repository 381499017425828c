"""Likelihoods, motion and interaction of ellipses in images."""
