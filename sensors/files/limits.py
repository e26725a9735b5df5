"""Bounds on what files from outside may claim."""

MAX_IMAGE_SIDE = 8192
"""Largest image side accepted from outside: bounds the memory a hostile file can ask for."""
