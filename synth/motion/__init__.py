"""Recorded motions on any body: where they stand, sit and jump, as poses and as films."""
