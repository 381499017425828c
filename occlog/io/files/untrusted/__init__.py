"""Files that others wrote: what is looked at before a parser gets them, and what a parser raises."""
