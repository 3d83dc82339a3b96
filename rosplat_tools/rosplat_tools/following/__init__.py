"""Maps as others make them: files that trainers write, other packages' messages."""
