"""Images in, clusters, appearance and rendered images out; no file access."""
