"""Inference runtimes, each network in a separate process."""
