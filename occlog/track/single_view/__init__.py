"""Trackers of plug-ins that follow the boxes of each camera on its own: boxes in, boxes with identities out."""
