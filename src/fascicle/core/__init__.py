"""Leads, units, parameters, errors, files and progress: what every package uses."""
