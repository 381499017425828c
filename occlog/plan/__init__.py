"""`occlog plan`: predict tracking errors over the floor, and rank placements of sensors."""
