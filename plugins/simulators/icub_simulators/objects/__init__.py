"""Object sets: what can be put on the table."""
