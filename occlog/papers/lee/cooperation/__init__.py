"""[Lee] Ch. 3: acoustic tracking with cameras that are asked on demand."""
