"""Times: of frames, in texts, for people."""
