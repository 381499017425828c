"""Where trackers in images begin: initial ellipses, boxes, moving regions."""
