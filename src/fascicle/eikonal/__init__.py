"""Activation times of tissue and trees together."""
