"""Approximate Bayesian computation informed by the surrogate."""
