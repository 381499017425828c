"""Figures of many targets at once: CLEAR-MOT, IDF1, HOTA, failure rates, and distances between sets of targets."""
