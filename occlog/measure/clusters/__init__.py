"""People in a foreground region: mixture of person-shaped Gaussians by EM, and outlines where several touch."""
