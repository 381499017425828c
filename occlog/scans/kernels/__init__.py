"""Kernels over the measurements of all sensors."""
