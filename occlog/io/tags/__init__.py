"""Readers of radio tags: tables of their places, and logs of their reads."""
