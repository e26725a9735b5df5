"""Recordings of frames in one MCAP file: written, indexed, read."""
