"""Executors of independent pieces of work: this process, processes of this machine, or a cluster."""
