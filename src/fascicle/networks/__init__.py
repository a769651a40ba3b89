"""Networks of a prior: what is learnt, their simulation, their comparison with recordings."""
