"""Tables over many recordings: what each run gave, with a column that names its recording."""
