"""What is put aside while a command runs, in memory or in files without names."""
