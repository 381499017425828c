"""Learning of appearance by viewing angle, and re-identification of boxes."""
