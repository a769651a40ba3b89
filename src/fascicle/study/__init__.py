"""A study: one fit on disk, from its settings to its results.

`fit` opens a `Study` (a folder) for a heart, a target and `FitSettings`. Its `Run` goes through the
stages: design, optimisation, refinement, population. Whatever a stage proposes or evaluates passes
through the `Journal`, which keeps it in the `Database` and evaluates points with the `Problem`: the
one place that knows both the forward model and the loss. What comes out is a `Population`. One
process at a time holds the `study_lock`.
"""
