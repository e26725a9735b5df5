"""Cameras, frames, calibrations, sessions and devices: what a rig of depth, colour and thermal sensors yields."""
