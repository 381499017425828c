"""The experiments of Ercan, El Gamal and Guibas (2013)."""
