"""What a page states: figures in words, the plane of sight."""
