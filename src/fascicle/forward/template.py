"""The template U of the ECG, taken from a front in a cable once and kept on disk."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.files import ArrayCache, user_cache
from fascicle.core.ranges import check_kind
from fascicle.forward import cable as cable_module
from fascicle.forward.cable import CableRun, max_upstroke, simulate_cable
from fascicle.kernels import cable as kernels
from fascicle.kernels import ten_tusscher
from fascicle.kernels.cable import CellModel
from fascicle.kernels.ten_tusscher import CELLS

# All the code that decides the content of a template, for the names of its files
SOURCES = [Path(__file__), *(Path(str(m.__file__)) for m in (ten_tusscher, kernels, cable_module))]
UNTIL = 60.0  # ms after the upstroke
TAPER = 10.0  # ms over which the window fades U′ out


@dataclass(frozen=True, eq=False)
class CableTemplate:
    """An action potential of a cable, cut for the QRS; an `ActionPotential`.

    Time 0 is that of the maximum upstroke, by convention the activation time τ of an eikonal front.
    Until `until` − `TAPER` ms after it the template is the cable's record; then U′ fades out, by a
    cubic of which neither U nor U′ shows a kink, and U stays. The record goes on to repolarisation
    (`full`), but an ECG must not: with one template everywhere all cells repolarise in the order in
    which they fired, which draws a T wave opposite to the QRS, where a heart, in which late cells
    have short action potentials, draws one along it. What U does in the plateau is slow: the QRS
    does not feel where it stops (`default_template` gives numbers),
    and the forward model's time grows with it.

    Two templates are equal if their content is.

    Attributes
    ----------
    cell : str
        Type of the cells.
    times : (n,) array
        Of the record (ms since the maximum upstroke), increasing.
    potentials : (n,) array
        Transmembrane potential at these (mV).
    speed : float
        Conduction velocity in the cable (mm/ms).
    until : float
        When U stops (ms).
    """

    cell: str
    times: Floats
    potentials: Floats
    speed: float
    until: float = UNTIL

    def __post_init__(self) -> None:
        if not TAPER <= self.until <= self.times[-1]:
            raise InputError(
                f"template until {self.until:g} ms: give {TAPER:g} ms to the end of the record, "
                f"{self.times[-1]:g} ms"
            )

    @property
    def span(self) -> tuple[float, float]:
        """See `ActionPotential`."""
        return -4.0, self.until  # the foot of the front is below 1e-6 of the rise before

    def __call__(self, time: Floats) -> Floats:
        """See `ActionPotential`."""
        return np.asarray(self._window(np.clip(time, *self.span)))

    def full(self, time: Floats) -> Floats:
        """The whole record at `time` (ms since the upstroke), with repolarisation (mV).

        Constant before and after it. For plots; see the class for why not for an ECG.
        """
        return np.asarray(self._record(np.clip(time, self.times[0], self.times[-1])))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the content."""
        content = hashlib.sha256(f"{self.cell} {self.speed!r} {self.until!r}".encode())
        content.update(np.stack([self.times, self.potentials]).tobytes())
        return content.hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, CableTemplate) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def __reduce__(self) -> tuple[object, ...]:
        return CableTemplate, (self.cell, self.times, self.potentials, self.speed, self.until)

    def __repr__(self) -> str:
        return f"CableTemplate({self.cell}, until={self.until:g} ms, {self.digest[:12]})"

    @cached_property
    def _record(self) -> CubicSpline:
        return CubicSpline(self.times, self.potentials)

    @cached_property
    def _window(self) -> CubicSpline:
        """The primitive of the record's U′ times a window, as a spline through its knots."""
        begin, end = self.span
        inside = self.times[(self.times > begin) & (self.times < end)]
        knots = np.concatenate([[begin], inside, [end]])
        node, weight = np.polynomial.legendre.leggauss(3)  # U′ is quadratic, the window cubic
        width = np.diff(knots)
        at = knots[:-1, None] + width[:, None] * (node + 1) / 2
        opened = _smoothstep((at - begin) / 0.5)  # ms
        window = opened * _smoothstep((end - at) / TAPER)
        rise = (self._record(at, 1) * window) @ weight * width / 2
        values = self._record(begin) + np.concatenate([[0.0], np.cumsum(rise)])
        return CubicSpline(knots, values, bc_type="clamped")


def _smoothstep(x: Floats) -> Floats:
    """0 below 0, 1 above 1, and the cubic 3x² − 2x³ between."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))


def cell_action_potential(cell: CellModel, **settings: float) -> CableTemplate:
    """The action potential of the ECG from a front in a cable of cells, for `ForwardModel`.

    Takes seconds to minutes.

    Parameters
    ----------
    cell : CellModel
        The model of the cells.
    **settings
        Of `fascicle.forward.cable.simulate_cable`: `diffusivity`, `length`, `duration`,
        `spacing`, `step`, `beats`.

    Returns
    -------
    CableTemplate
        U (mV) as a function of the time since activation (ms), until 60 ms after the upstroke.

    Raises
    ------
    InputError
        If a setting is out of range, or no front arrives at the end of the cable.
    """
    check_kind(cell, CellModel, "cell", "a fascicle.CellModel")
    return template_of(simulate_cable(cell, **settings), cell.name)  # type: ignore[arg-type]


def template_of(run: CableRun, cell: str, until: float = UNTIL) -> CableTemplate:
    """Cut the template out of a cable's record, until so long after the maximum upstroke (ms).

    The record is kept in steps that are short near the upstroke, so that it is small enough to go
    along with every task.
    """
    times = run.time - max_upstroke(run.time, run.potential)[1]
    edges = np.clip([-np.inf, -5.0, -2.0, 3.0, 15.0, 100.0, np.inf], times[0], times[-1])
    steps = (5.0, 0.05, 0.02, 0.05, 0.5, 2.0)  # ms from each of these on
    parts = [
        np.linspace(begin, end, int(np.ceil((end - begin) / step)), endpoint=False)
        for begin, end, step in zip(edges[:-1], edges[1:], steps, strict=True)
    ]
    kept = np.concatenate([*parts, edges[-1:]])
    return CableTemplate(cell, kept, CubicSpline(times, run.potential)(kept), run.speed, until)


@cache
def default_template() -> CableTemplate:
    """The template U of the ECG: endocardial cells, until 60 ms after the upstroke.

    Seconds the first time on a machine, a file later (`stored_template`).

    Notes
    -----
    The paper says "a 1D cable simulation with the Ten Tusscher-Panfilov model" and not which cell.
    One template represents all layers, so their differences would enter the ECG with the
    wrong sign somewhere; the endocardial type has least of it. On the packaged heart with the
    example parameters, 5 ms after the last activation, the largest lead is at 0.007 mV with the
    endocardial template and at 0.052 and 0.066 mV with the epicardial and the mid-myocardial one,
    whose notch (phase 1) is deep everywhere at once and so lifts the ST segment, though no
    difference between layers is modelled that a J wave could come from.

    That U stops at 60 ms changes no lead of the QRS by more than 0.007 mV of 2.36 mV. At 40 ms it
    would be 0.009 mV for this type and 0.033 mV for the others, at 25 ms 0.038 and 0.126 mV.
    """
    return stored_template("endocardial")


def stored_template(cell: str) -> CableTemplate:
    """The template of a type of ten Tusscher and Panfilov's cell, from the cache or simulated.

    The file lies in `fascicle.core.files.user_cache`; its name is a hash of the code and constants
    that decide the content, and of this package's version. A damaged or unwritable cache only means
    that it is computed again. Types are ``"endocardial"``, ``"midmyocardial"``, ``"epicardial"``.
    """
    content = b"".join([cell.encode(), *(source.read_bytes() for source in SOURCES)])
    cache, key = ArrayCache(user_cache(), "template"), hashlib.sha256(content).hexdigest()
    stored = cache.read(key)
    if stored is not None:
        return CableTemplate(cell, stored["times"], stored["potentials"], float(stored["speed"]))
    template = template_of(simulate_cable(CELLS[cell]), cell)
    arrays = {"times": template.times, "potentials": template.potentials, "speed": template.speed}
    cache.keep(key, arrays)
    return template
