"""Whether an estimate can be believed: doubts of its rows, residuals of its bearings, the verdict in words."""
