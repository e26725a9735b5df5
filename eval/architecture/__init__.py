"""Architectures of the networks, in PyTorch."""
