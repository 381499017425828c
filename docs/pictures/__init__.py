"""Pictures of the pages; `python -m docs.pictures` makes them anew."""
