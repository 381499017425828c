"""`occlog doctor`: search for all faults in files."""
