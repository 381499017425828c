"""[Ercan] Sec. 7 on recorded detections that virtual occluders hide."""
