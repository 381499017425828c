"""Recordings and results for third-party viewers: Foxglove, Lichtblick, Rerun."""
