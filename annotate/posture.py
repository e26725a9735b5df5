"""Postures that a network tells apart, by index."""

POSTURES = ("standing", "sitting", "lying", "crouching", "kneeling", "on all fours")
