"""Arrays in, arrays out: boxes and how they overlap, motion of boxes, smoothing."""
