"""What all formats share: Parquet, CSV, JSON, YAML, XML, times, atomic outputs, provenance."""
