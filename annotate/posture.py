"""Posture classes, in the order of the network's outputs."""

POSTURES = ("standing", "sitting", "lying", "crouching", "kneeling", "on all fours")
