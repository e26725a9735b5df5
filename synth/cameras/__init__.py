"""Models of depth and thermal cameras: noise, faults, lenses."""
