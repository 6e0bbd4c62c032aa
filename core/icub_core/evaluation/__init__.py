"""Measures of quality, and the one form in which figures are written."""
