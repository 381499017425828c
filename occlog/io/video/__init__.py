"""Containers of video: MP4, AVI and Matroska, read for their times and their damage."""
