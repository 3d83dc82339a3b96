"""Publishes those parts of scenes larger than memory that viewers look at."""
