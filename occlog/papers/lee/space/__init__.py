"""[Lee] Ch. 2: tracking in space, directly and by projected planes."""
