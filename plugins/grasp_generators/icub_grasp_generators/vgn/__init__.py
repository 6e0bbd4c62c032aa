"""Volumetric grasping: a truncated signed distance field in, a grasp for every voxel out."""
