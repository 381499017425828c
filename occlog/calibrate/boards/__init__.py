"""Lenses from images of a chessboard or ChArUco board."""
