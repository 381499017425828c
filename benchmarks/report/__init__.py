"""What the pages of runs cost."""
