"""Boxes of detectors: CSV, COCO and other JSON, YOLO, MOTChallenge."""
