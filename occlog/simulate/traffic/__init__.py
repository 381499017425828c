"""Verb: simulate the data traffic of cooperating sensors, and the delays of their answers."""
