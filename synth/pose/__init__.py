"""Postures drawn at random and settled without collisions."""
