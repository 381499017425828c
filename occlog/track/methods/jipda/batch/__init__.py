"""Everybody with the future: tracks of a whole recording or a window, by Markov chain Monte Carlo and smoothing."""
