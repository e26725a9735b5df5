"""Recorded motions on any body: floor contact, seats and jumps; single poses and films."""
