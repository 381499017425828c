"""Mathematics shared by several packages (arrays in, arrays out); one topic per folder."""
