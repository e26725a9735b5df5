"""Devices opened by address or rig file, and recorded."""
