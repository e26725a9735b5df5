"""Cameras together: geometry, calibration, frames, clocks and pairing."""
