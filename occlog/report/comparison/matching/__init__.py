"""Two runs compared moment by moment: who is who, how far both are from the truth, and where they part."""
