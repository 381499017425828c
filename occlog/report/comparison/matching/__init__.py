"""Two runs compared time step by time step: who is who, how far both are from the truth, and where they part."""
