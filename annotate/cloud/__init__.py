"""The thermal-coloured cloud of one frame, and neighbourhoods of its points."""
