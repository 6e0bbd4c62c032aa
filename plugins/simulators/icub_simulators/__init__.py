"""Physics engines and object sets."""
