"""The formulas of [Ercan] for noise and for what moving occluders hide, and how exact they are."""
