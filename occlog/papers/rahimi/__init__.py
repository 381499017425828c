"""The experiments of Rahimi, Dunagan and Darrell (2004)."""
