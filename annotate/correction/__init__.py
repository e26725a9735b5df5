"""A person's work on labels: selecting, painting, undoing, propagating, replaying."""
