"""Approximate Bayesian computation: prior, distance, rejection, random walks."""
