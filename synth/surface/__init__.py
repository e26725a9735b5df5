"""Triangle meshes: rasterising, noise patterns, furniture."""
