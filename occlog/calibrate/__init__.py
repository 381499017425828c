"""Calibration of cameras and clocks from boxes of walking people."""
