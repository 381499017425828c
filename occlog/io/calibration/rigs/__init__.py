"""Calibrations of whole rigs: Kalibr, ROS, COLMAP, OpenCV in pairs of files, projection matrices in arrays."""
