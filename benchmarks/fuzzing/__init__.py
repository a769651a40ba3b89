"""Damaged files of every kind that is read, and wrong arguments: their outcomes.

    python -m benchmarks.fuzzing [KIND ...] [--number 20000] [--first 0]

Prints for each kind how many inputs were read, how many were refused in one line, and everything
else: errors of other kinds, more than a minute, more than 2 GB.
"""
