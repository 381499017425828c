"""Video of people who walk in a room, by ray casting."""
