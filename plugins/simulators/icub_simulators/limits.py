"""Speeds above which a simulation counts as exploded."""

FASTEST_JOINT = 200.0
"""rad/s; the fastest finger moves at about 10."""
FASTEST_OBJECT = 30.0
"""m/s; ten times that of a fall from the table."""
FASTEST_SPIN = 500.0
"""rad/s; a light object flicked by a finger reaches 100."""
