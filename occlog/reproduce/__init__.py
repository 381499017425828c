"""Experiments of papers, run anew: a table, a plot, and a verdict for each statement of the paper's text."""
