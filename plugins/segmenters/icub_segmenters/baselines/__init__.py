"""What the on-line segmenter is compared with, on the same features and data."""
