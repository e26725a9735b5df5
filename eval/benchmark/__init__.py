"""Public benchmarks: frames with true joints, their usual precision measure, published figures."""
