"""`occlog batch`: run the stages for each of many recordings, and collect results in common tables."""
