"""A map with fewer splats that looks the same, from the map alone."""
