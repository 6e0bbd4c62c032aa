"""The Bullet engine."""
