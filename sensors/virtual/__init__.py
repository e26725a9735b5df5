"""Virtual twins: devices made of software behind the very seams of the real ones, for trying things out."""
