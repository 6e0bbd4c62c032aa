"""FEATURE-TASK: rendered images of invented objects on which feature extractors are pre-trained."""
