"""Grasping policies."""
