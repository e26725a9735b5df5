"""The virtual rig: whole recordings with the truth of every pixel."""
