"""Recordings and their targets: beats, their mean and spread, the QRS window."""
