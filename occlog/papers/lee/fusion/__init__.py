"""[Lee] Ch. 4: fusion of detections."""
