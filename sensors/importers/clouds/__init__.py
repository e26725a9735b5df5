"""Point cloud files as depth images."""
