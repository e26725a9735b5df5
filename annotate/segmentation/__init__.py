"""Person points to body parts, with a confidence for every pixel."""
