"""Method `map`: the most probable trajectory from all bearings at once."""
