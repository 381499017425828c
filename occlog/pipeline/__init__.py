"""Commands that drive others: all stages of a configuration, and Monte Carlo sweeps."""
