"""Whether an estimate can be accepted: doubts of its rows, residuals of its bearings, the verdict in words."""
