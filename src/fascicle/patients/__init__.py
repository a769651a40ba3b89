"""Cohorts: a table of patients with heart and recording, their studies, and an overview page."""
