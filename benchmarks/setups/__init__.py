"""Set-ups with one fault each, and without: whether occlog names the fault, and is silent otherwise."""
