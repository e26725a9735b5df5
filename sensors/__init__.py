"""Cameras, frames, calibrations, sessions and devices: what a rig of sensors yields."""
