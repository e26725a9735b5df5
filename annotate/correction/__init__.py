"""Correction of labels by a person: selecting, painting, undoing, propagating, replaying."""
