"""A map for the programs of others."""
