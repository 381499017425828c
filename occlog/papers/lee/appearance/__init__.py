"""[Lee] Sec. 5.2.1: appearance of people by viewing direction."""
