"""Experiments, their trials, and the rules by which statements are judged."""
