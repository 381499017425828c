"""Metrics of tracking: position errors, CLEAR-MOT, IDF1, HOTA, GOSPA, failure rates."""
