"""Style, SVG and thinning of curves."""
