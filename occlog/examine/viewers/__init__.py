"""Recordings and results for viewers of others: Foxglove, Lichtblick, Rerun."""
