"""Verb: run the papers' experiments and judge each statement; nothing else uses this room."""
