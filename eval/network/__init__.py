"""Networks: architectures, weights, prediction."""
