"""Scenes and scripted paths in YAML."""
