"""Suit segmentation: a network labels each pixel of a person in a suit with its part."""
