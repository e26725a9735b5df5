"""Markers to joint angles, and motions on disk."""
