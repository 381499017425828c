"""Boxes of calibrated cameras to methods that follow everybody, and from these to tables."""
