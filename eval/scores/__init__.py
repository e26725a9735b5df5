"""Scores of one set of labels against another."""
