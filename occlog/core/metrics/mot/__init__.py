"""Metrics of many targets: CLEAR-MOT, IDF1, HOTA, failure rates, and distances between sets of targets."""
