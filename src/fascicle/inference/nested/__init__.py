"""Sampling a posterior from its likelihood, by nested sampling."""
