"""One file a command: parse, read, call one stage, write, summarise."""
