"""Point clouds of frames with colour and temperature, and neighbourhoods of their points."""
