"""Camera calibrations of other programs."""
