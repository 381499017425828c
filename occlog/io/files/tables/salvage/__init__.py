"""Tables that were cut off or damaged: groups of rows that can be known, and read, without the footer of the file."""
