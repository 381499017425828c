"""Files of motion models, fundamental matrices, ellipses, matches, and the schemas."""
