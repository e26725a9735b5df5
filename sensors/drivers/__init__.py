"""Drivers of real cameras and pyrometers."""
