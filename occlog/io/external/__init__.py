"""External tables of other programs, recognised by their columns and converted to occlog tables."""
