"""Verb: run the papers' experiments and judge each statement; with verbs of one paper; nothing else uses this room."""
