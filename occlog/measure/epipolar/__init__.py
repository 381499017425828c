"""`occlog epipolar`: estimate the epipolar geometry of pairs of views, or check it."""
