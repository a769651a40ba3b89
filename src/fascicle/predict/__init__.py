"""Scenarios over a posterior: what pacing would do."""
