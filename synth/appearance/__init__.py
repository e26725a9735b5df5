"""Colour, light and surface temperature of synthetic people and rooms."""
