"""Consistency checks of estimates: quality flags of rows, residuals of bearings, findings in words."""
