"""What a page says: figures in words, the plane of sight."""
