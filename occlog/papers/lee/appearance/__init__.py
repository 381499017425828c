"""[Lee] Sec. 5.2.1: how people look from several sides."""
