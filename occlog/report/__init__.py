"""Records in, figures and page out."""
