"""Batches of networks on a graphics card."""
