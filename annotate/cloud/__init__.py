"""Thermal-coloured clouds of frames, and neighbourhoods of their points."""
