"""Method `apf`: auxiliary particle filter among occluders, with selection of cameras."""
