"""Ellipses in images and histograms of their colours."""
