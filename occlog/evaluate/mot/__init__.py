"""Evaluation of many targets: CLEAR-MOT, IDF1, HOTA, GOSPA, failure rates."""
