"""Salvage of the intact messages of a damaged recording into a new one."""
