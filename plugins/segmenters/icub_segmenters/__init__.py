"""Segmentation: feature extractors, on-line heads, and the segmenters composed of them."""
