"""Prediction in memory."""
