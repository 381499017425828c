"""`occlog verify`: repeat a packed run, and compare the outputs."""
