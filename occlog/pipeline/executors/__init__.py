"""Executors of independent tasks: this process, local processes, or a cluster."""
