"""Trajectories in formats that are no tables with a header: TUM, TRC, GeoJSON."""
