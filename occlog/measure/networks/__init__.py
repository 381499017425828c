"""Neural networks in ONNX files: boxes of objects in images, and appearance vectors (embeddings) of them."""
