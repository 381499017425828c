"""`occlog diff`: whether two outputs are the same, and where they first differ."""
