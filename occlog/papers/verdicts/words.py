"""The words of a verdict."""

REPRODUCED, IN_PART, NOT, UNDECIDED = "reproduced", "in part", "not reproduced", "not decided"
WORDS = (REPRODUCED, IN_PART, NOT, UNDECIDED)
"""All of them, in the order of tables."""
