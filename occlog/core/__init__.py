"""Mathematics that several rooms use, arrays in and arrays out; one chapter a folder."""
