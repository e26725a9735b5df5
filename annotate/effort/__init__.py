"""The simulated annotator: what it would do with the window, and how long that would take."""
