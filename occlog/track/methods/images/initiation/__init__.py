"""Where trackers in images begin: first ellipses, boxes, moving regions."""
