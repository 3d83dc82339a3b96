"""Pictures through the whole chain, of the cameras of a file."""
