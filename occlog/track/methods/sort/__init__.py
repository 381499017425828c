"""Method `sort`: boxes of one camera tracked in its image, without a calibration."""
