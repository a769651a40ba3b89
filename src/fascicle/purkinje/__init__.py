"""Purkinje trees: the chart they grow in, growth, the tree, its files."""
