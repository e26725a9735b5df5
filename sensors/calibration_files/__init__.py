"""Cameras and rigs as other programs write them: YAML, JSON, text, messages."""
