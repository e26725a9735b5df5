"""Calibration files of other programs: YAML, JSON, text, messages."""
