"""Consistency checks of estimates: quality flags of rows, residuals of bearings, and findings in words."""
