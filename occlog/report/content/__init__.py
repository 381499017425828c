"""Content of report pages."""
