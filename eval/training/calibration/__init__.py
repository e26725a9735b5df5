"""Calibration of confidences and deviations on bodies that were not trained on."""
