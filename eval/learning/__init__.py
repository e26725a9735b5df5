"""A network that adapts to one person and room from the frames that people have corrected."""
