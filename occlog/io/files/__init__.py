"""Shared parts of all formats: Parquet, CSV, JSON, YAML, XML, times, atomic outputs, provenance."""
