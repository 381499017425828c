"""Method `joint`: one particle filter for all labelled objects, with mutual occlusion."""
