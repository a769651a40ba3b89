"""Many patients: a table with a heart and a recording each, their studies, and one page of all."""
