"""Tables in Parquet: read, written, checked and salvaged."""
