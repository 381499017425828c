"""Neural networks in ONNX files: object detection, and appearance vectors (embeddings)."""
