"""Figures of merit: errors of positions, CLEAR-MOT, IDF1, HOTA, GOSPA, failure rates."""
