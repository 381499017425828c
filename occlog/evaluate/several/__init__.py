"""Several recordings in one table: `occlog evaluate --also`."""
