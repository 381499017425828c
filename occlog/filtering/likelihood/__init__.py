"""Likelihoods of measurements at given positions of a target, and their linearisations."""
