"""Virtual rig: simulated recordings with the truth of every pixel."""
