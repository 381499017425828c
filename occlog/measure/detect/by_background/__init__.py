"""Detection of people by background subtraction: regions, assignment to targets, rows."""
