"""Verb: fuse detections of several cameras, or tracks of several groups of cameras."""
