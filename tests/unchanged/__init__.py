"""Two checkouts of occlog give the same results: outputs, verdicts, speed, and tests that notice errors."""
