"""Detections of calibrated cameras to multi-person trackers, and tracks to tables."""
