"""Parsers of video containers (MP4, AVI, Matroska) for frame times and damage."""
