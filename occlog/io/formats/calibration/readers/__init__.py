"""Readers of calibrations, one module a format."""
