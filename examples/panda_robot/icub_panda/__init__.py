"""Franka's Panda as a robot plugin of icub-kit."""
