"""People as regions that differ from the empty scene: found, chosen for targets, made rows."""
