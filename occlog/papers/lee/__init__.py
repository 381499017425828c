"""The experiments of Lee (2009)."""
