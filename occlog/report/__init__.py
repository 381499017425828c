"""Figures and pages: records in, one offline page and one picture out."""
