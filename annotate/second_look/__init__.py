"""A second look at every supervoxel: what a small network makes of all that the first one found out."""
