"""Purkinje trees: growth from parameters, junctions."""
