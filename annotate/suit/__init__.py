"""Palette of the colour-coded clothing, its colours in a frame's light, and its learning."""
