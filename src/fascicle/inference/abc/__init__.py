"""Approximate Bayesian computation: prior, distance, rejection."""
