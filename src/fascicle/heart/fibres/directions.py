"""Fibre directions: from whatever they are given on to one unit vector per tetrahedron."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.mesh.measures import unit

# Points of two files are the same when they are this close, as a fraction of the mesh's extent:
# room for single precision.
MATCH = 1e-5


def match_by_position(name: str, given: Floats, wanted: Floats, what: str) -> Integers:
    """For every wanted position, the row of `given` at the same place.

    Parameters
    ----------
    name, what : str
        For an error: the file of the given positions, and what the wanted ones are.
    given, wanted : (n, 3) and (k, 3) arrays
        Positions (mm).

    Returns
    -------
    (k,) array
        Rows of `given`.

    Raises
    ------
    InputError
        If a wanted position has none.
    """
    distance, row = cKDTree(given).query(wanted)
    tolerance = MATCH * float(np.ptp(wanted, axis=0).max())
    bad = np.flatnonzero(distance > tolerance)
    if bad.size:
        raise InputError(
            f"{name}: no fibre within {tolerance:.2g} mm of {bad.size} of {len(wanted)} {what} of "
            f"the mesh (largest gap {distance.max():.3g} mm); give fibres on the same mesh"
        )
    return np.asarray(row, dtype=np.int64)


def average_to_tetrahedra(fibres: Floats, tetrahedra: Integers) -> Floats:
    """Mean axis of each tetrahedron's four vertex fibres, shape (m, 3).

    Fibres have no sign, so the mean is the principal axis of Σ f⊗f.
    """
    corner = unit(fibres)[tetrahedra]
    _, axes = np.linalg.eigh(np.einsum("mki,mkj->mij", corner, corner))
    return np.asarray(axes[:, :, -1])
