"""Many targets: CLEAR-MOT, IDF1, HOTA, GOSPA, failure rates."""
