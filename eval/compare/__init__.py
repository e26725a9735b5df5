"""Whole label sets compared, and the results on disk."""
