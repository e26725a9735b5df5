"""Models of depth and thermal cameras: noise, lenses."""
