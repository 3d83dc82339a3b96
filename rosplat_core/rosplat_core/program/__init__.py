"""How programs speak and write files."""
