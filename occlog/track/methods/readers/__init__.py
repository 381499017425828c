"""Methods `virtual` and `rssi`: tags from the reads of fixed readers, by coverage or by strength of the signal."""
