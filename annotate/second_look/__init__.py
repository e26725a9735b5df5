"""Second look: labels of every supervoxel by a small network, from all results of the first reading."""
