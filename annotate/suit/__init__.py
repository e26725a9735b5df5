"""Palette of the colour-coded suit, its colours in a frame's illuminant, and the estimation of both."""
