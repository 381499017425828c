"""Methods `direct3d` and `pps`: particle filters in space."""
