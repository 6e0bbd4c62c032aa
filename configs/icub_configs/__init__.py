"""Hydra configuration: one group a plugin kind, and presets."""
