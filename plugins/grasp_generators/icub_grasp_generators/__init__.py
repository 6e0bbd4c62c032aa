"""Grasp-pose generators for the iCub hand."""
