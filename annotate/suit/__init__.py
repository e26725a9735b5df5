"""Palette of the colour-coded clothing, its colours in a frame's illuminant, and its estimation."""
