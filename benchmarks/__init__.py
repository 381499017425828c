"""Speed of occlog as ratios: ours to a baseline, measured in turn in the same run."""
