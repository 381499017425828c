"""Verb: learn how people look from several sides, and tell by it whom a box shows."""
