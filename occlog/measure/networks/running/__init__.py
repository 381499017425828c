"""Programs that run networks, each network in a process of its own."""
