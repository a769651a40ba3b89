"""Figures and tables.

Each figure is a function of plain data in its own module; import that module where the figure is
drawn, since Matplotlib loads with it. This package itself imports nothing.
"""
