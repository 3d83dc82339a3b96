"""The report that users attach to an issue about drawing."""
