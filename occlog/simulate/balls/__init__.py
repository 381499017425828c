"""Similar balls, rendered for several cameras."""
