"""Parametric bodies: skeleton, skin, parts, flesh. "The paper" is Nishi & Miura 2017 (README)."""
