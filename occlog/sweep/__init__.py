"""Monte Carlo runs over seeds and parameters: one trial, many of them in parallel, and their statistics."""
