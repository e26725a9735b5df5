"""Colour and warmth of people and rooms."""
