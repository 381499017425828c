"""Shared parts of all file formats: Parquet, CSV, JSON, YAML, XML, times, atomic outputs, provenance."""
