"""The page of an experiment: tables, plots, verdicts."""
