"""`occlog start`: inspects files, and writes and runs a configuration for them."""
