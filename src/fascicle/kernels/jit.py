"""How the hot kernels are compiled."""

from __future__ import annotations

from functools import partial

from numba import njit

# `_nrt` is not among Numba's documented options: a version without it refuses it loudly. Numba's
# cache on disk sees changes of a kernel's own file only, not of those it imports.
#
# Compiled once per machine, run outside Python's global lock, and without reference counts: a
# kernel that allocates nothing needs none, and they took half of the sweep's time. Numba refuses to
# compile an allocation in such a kernel, so the work arrays come from outside.
kernel = partial(njit, cache=True, nogil=True, _nrt=False)
