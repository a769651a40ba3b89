"""Scenarios over a population: what pacing would do."""
