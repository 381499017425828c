"""Accuracy of bearings, azimuths and detections."""
