"""The figures and tables of [Qu], one file each."""
