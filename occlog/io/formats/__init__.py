"""File formats of other programs and of models: one module or folder a family, with a table of its formats."""
