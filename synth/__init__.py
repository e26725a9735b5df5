"""Synthetic bodies, poses, renderings and datasets, and the virtual rig with its ground truth."""
