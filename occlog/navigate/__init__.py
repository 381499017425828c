"""Verb: drive a robot through a scene by potential fields, around obstacles and tracked people."""
