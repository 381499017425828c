"""The trajectory as an optimisation problem: terms, Newton system, constraints, windows."""
