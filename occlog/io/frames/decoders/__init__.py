"""Decoders in separate processes: fork server, jobs, and shared memory for images."""
