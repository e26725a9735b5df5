"""Simulated annotator: its corrections with the window's operations, and the time that they take."""
