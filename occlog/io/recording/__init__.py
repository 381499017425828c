"""Recordings: MCAP files read, written, copied and guarded against damage."""
