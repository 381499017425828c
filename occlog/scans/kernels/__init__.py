"""Compiled loops over the measurements of all sensors."""
