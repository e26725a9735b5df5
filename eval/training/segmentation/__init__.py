"""Training of the suit segmentation network."""
