"""`occlog sweep`: Monte Carlo runs over seeds and parameters, in parallel."""
