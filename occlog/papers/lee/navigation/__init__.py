"""Verb `navigate`: drive a robot through a scene by potential fields; and its experiments, [Lee] Sec. 5.2.2."""
