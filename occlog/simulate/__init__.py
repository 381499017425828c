"""`occlog simulate`: make a recording with ground truth from a scene."""
