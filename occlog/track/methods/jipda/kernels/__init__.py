"""Numerical kernels: expected boxes, occlusion, association by belief propagation, updates (arrays in, arrays out)."""
