"""Contract checks for plugins, usable without pytest, and tiny plugins of every kind to run them with."""
