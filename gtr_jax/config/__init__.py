"""Robot files: their schema, checked, read and written."""
