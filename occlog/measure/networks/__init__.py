"""Neural networks in ONNX files: boxes of objects in images, and vectors that state how they look."""
