"""Fibre directions: given ones, and those of rules."""
