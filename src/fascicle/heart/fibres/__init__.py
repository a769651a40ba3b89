"""Fibre directions by rule."""
