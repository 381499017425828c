"""Whether the boxes of cameras agree: detection rates, clocks, calibrations and files."""
