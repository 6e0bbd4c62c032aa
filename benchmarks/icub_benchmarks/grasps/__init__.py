"""grasps."""
