"""Clothes of synthetic people: displaced skin, hanging cloth, hair, shoes, bags, and garments from files."""
