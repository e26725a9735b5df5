"""Random postures, settled without collisions."""
