"""Verb: gather video, detections, directions and calibration into one recording."""
