"""Experiments, and the rules by which statements are judged."""
