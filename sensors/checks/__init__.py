"""Plausibility of cameras, depth images, temperatures and mounting."""
