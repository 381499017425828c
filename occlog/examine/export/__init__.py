"""`occlog export`: write tables in the formats of other programs."""
