"""Composition of a run's configuration: typed nodes from constructor signatures, Hydra groups, checked overrides."""
