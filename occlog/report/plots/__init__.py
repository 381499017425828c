"""One file a plot of the page."""
