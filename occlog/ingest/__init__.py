"""Verb: collect video, detections, directions and calibration into one recording."""
