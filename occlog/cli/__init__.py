"""The group of commands, the options that they share, and how values are parsed."""
