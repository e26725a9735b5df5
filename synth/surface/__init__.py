"""Triangles: rasterising, patterns, furniture."""
