"""Parametric bodies: skeleton, skin, parts, flesh."""
