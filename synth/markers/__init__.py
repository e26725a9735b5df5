"""Conversion of markers to joint angles, and motion files."""
