"""Invented household things: the object set, its kinds, and the solids that they are built of."""
