"""Data sets, rendered and read from disk."""
