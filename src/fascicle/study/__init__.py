"""A study: one fit on disk, from its settings to its results.

`fit` opens a `Study` (a folder) for a heart, a target and `FitSettings`. A `PaperFit` or a
`PosteriorFit` goes through its stages. Whatever a stage proposes or evaluates passes through the
`Journal`, which keeps it in the `Database`. Points are evaluated by `evaluate`: a `PointSimulator`
makes ECGs of them, a `TargetComparison` compares these with a recording. What comes out is a
`Population`. One process at a time holds the `study_lock`.
"""
