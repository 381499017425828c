"""Recursive Bayesian filters: motion models, likelihoods, posteriors, track life cycle, smoothing."""
