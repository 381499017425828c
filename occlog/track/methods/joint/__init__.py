"""Method `joint`: one particle filter for all labelled objects, which hide one another."""
