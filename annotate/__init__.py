"""Point clouds, body parts, labels and their correction."""
