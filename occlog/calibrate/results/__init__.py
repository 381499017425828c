"""What a calibration writes: scenes, calibrations of other programs, pictures of residuals."""
