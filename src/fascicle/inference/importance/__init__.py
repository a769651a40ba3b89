"""Sampling a posterior from its likelihood, by adaptive importance sampling."""
