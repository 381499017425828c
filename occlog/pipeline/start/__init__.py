"""Inspects files as people have them, and writes and runs a configuration for them."""
