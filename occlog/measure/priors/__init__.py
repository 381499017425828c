"""`occlog priors`: priors of moving occluders from views, positions or sound."""
