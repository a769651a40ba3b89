"""How the hot kernels are compiled."""

from __future__ import annotations

from functools import partial

from numba import njit

# `_nrt` is not among Numba's documented options: a version without it refuses it loudly. Numba's
# cache on disk sees changes of a kernel's own file only, not of those it imports.
#
# Compiled once per machine, and run outside Python's global lock
allocating_kernel = partial(njit, cache=True, nogil=True)

# Without reference counts, too: a kernel that allocates nothing needs none, and they took half of
# the sweep's time. Numba refuses to compile an allocation in such a kernel, so the work arrays come
# from outside.
kernel = partial(allocating_kernel, _nrt=False)
