"""Boxes of calibrated cameras to methods that follow all people, and from these to tables."""
