"""`occlog fuse`: fusion of the detections of several cameras, or of tracks of several groups of cameras."""
