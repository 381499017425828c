"""Arrays in, arrays out: the numeric kernels, free of files and of the rest of occlog."""
