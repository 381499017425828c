"""Parts of particle filters: log-weights, resampling, likelihoods of a scan."""
