"""Endocardium to unit disk: the chart in which trees grow."""
