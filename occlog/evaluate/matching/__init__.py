"""Which estimate belongs to which true target, and what evaluation makes of its input."""
