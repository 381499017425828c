"""Newton's method inside constraints: a point to start from, the search, and the system of each step."""
