"""Data of a sensor rig: cameras, frames, calibrations, sessions and devices."""
