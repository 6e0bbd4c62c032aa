"""Grasps from a superquadric fitted to the visible surface of an object."""
