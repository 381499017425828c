"""Programs that run networks, each network in a separate process."""
