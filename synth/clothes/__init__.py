"""Clothes of synthetic people: displaced skin, what hangs, hair, shoes, bags, and garments from files."""
