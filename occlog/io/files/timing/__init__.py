"""Times of rows and frames: parsing, units, UTC, and the choice of frames."""
