"""Gaussian processes for the loss and for feasibility."""
