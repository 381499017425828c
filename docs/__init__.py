"""Documentation; `python -m docs.make` writes the pages that are made from the code."""
