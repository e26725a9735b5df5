"""Virtual twins: software devices behind the same interfaces as the real ones, for trying things out."""
