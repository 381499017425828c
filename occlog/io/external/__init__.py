"""Tables that other programs made: known by their columns, and read as the tables of this one."""
