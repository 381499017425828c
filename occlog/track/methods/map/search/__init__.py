"""The search for the most probable trajectory: where it begins, and how it goes on among false bearings."""
