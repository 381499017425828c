"""Content of a page: figures in words, the plane of sight."""
