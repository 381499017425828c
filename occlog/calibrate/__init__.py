"""Calibration of cameras and clocks by people who walk."""
