"""Networks: weights, prediction."""
