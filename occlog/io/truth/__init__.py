"""Ground truth in the formats of data sets."""
