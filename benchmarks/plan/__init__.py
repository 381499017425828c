"""What `occlog plan` expects against what is found."""
