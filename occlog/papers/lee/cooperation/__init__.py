"""Chapter 3: cameras that are asked when it matters."""
