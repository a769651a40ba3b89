"""Learning from a callable: surrogate, optimisation, approximate Bayesian computation."""
