"""One function a stage: records in, records out, no files."""
