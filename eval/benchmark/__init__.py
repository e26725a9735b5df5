"""Benchmarks of other people: frames with true joints, the field's measure, published figures."""
