"""Posture classes of the network, by index."""

POSTURES = ("standing", "sitting", "lying", "crouching", "kneeling", "on all fours")
