"""Chapter 4: fused detections."""
