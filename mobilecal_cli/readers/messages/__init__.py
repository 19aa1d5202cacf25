"""Messages: one payload decoded, in one form for all encodings and equivalent types."""
