"""Virtual twins: software devices with the interfaces of the real ones, for trials without hardware."""
