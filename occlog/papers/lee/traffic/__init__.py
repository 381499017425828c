"""Verb `traffic`: data traffic of cooperating sensors, and delays of answers; its experiments, [Lee] Sec. 5.2.3."""
