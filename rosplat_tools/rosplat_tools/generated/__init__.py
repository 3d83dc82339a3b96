"""Generated scenes, a file each."""
