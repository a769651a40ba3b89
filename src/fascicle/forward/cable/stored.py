"""Templates that are simulated once and kept on disk."""

from __future__ import annotations

import hashlib
import zipfile
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np

from fascicle.core.cache import user_cache
from fascicle.core.errors import InputError
from fascicle.core.files import atomic_path
from fascicle.forward.cable import cell, measures, propagation, template
from fascicle.forward.cable.template import DEFAULT_CELL, CableTemplate, make_template
from fascicle.kernels import ten_tusscher

SOURCES = (ten_tusscher, cell, measures, propagation, template)  # all that decides the content


@cache
def default_template() -> CableTemplate:
    """The template U of the ECG: endocardial cells, until 60 ms after the upstroke.

    Seconds the first time on a machine, a file later (`stored_template`).

    Notes
    -----
    The paper says "a 1D cable simulation with the Ten Tusscher-Panfilov model" and not which cell.
    One template stands for all layers, so what the layers differ in would enter the ECG with the
    wrong sign somewhere; the endocardial type has least of it. On the packaged heart with the
    example parameters, 5 ms after the last activation, the largest lead is at 0.009 mV with the
    endocardial template and at 0.042 and 0.052 mV with the epicardial and the mid-myocardial one,
    whose notch (phase 1) is deep everywhere at once and so lifts the ST segment, though no
    difference between layers is modelled that a J wave could come from.

    That U stops at 60 ms changes no lead of the QRS by more than 0.010 mV of 1.70 mV. At 40 ms it
    would be as much for this type and 0.024 mV for the others, at 25 ms 0.028 and 0.091 mV.
    """
    return stored_template(DEFAULT_CELL)


def stored_template(cell: str) -> CableTemplate:
    """The template of a cell type, from the cache or else simulated and kept there.

    The file lies in `fascicle.core.cache.user_cache`; its name is a hash of the code and constants
    that decide the content, and of this package's version. A damaged or unwritable cache only means
    that it is computed again.

    Parameters
    ----------
    cell : str
        ``"endocardial"``, ``"midmyocardial"`` or ``"epicardial"``.
    """
    path = user_cache() / f"template-{_key(cell)}.npz"
    try:
        return _load(path, cell)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        made = make_template(cell)  # not there, or damaged
    with suppress(OSError, InputError):  # a full disk, or no place to write to
        _save(path, made)
    return made


def _key(cell: str) -> str:
    content = hashlib.sha256(f"{version('fascicle')} {cell}".encode())
    for module in SOURCES:
        content.update(Path(str(module.__file__)).read_bytes())
    return content.hexdigest()[:32]


def _save(path: Path, made: CableTemplate) -> None:
    with atomic_path(path) as temporary:
        np.savez(
            temporary,
            allow_pickle=False,
            times=made.times,
            potentials=made.potentials,
            speed=made.speed,
        )


def _load(path: Path, cell: str) -> CableTemplate:
    with np.load(path, allow_pickle=False) as file:
        return CableTemplate(cell, file["times"], file["potentials"], float(file["speed"]))
