"""The idealised trunk on whose skin given electrodes lie: the most probable one, then a bit more.

First the measures of the trunk, and where it lies around heart and electrodes, have their most
probable values: electrodes lie on the skin and near their standard sites, the heart has its usual
place, measures are those of adults. What is left between skin and electrodes a smooth deformation
takes up, the smallest that does, of skin, ribs and lungs together.

Sources
-------
Spread of measures : a half more than among the young and active adults of Heinz et al. 2003, J Stat
    Educ 11(2) (height 0.055 and girth 0.11 of their means); of the others, a tenth, our choice.
Electrodes : 20 to 30 mm from their sites in practice (Wenger and Kligfield 1996, J Electrocardiol
    29:179-184; Rajaganeshan et al. 2008, Int J Clin Pract 62:65-70).
Skin to heart : Rahko 2008, J Am Soc Echocardiogr 21:761-764 (32 mm, standard deviation 8).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.optimize import least_squares
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES
from fascicle.torso.body_size import BodySize
from fascicle.torso.electrode_sites import V1, site_rays
from fascicle.torso.heart_pose import BodyFrame, default_position
from fascicle.torso.trunk import WIDEST, Outside, outside_trunk

# One standard deviation of what is fitted; of measures, that of the logarithm
TILT = np.radians(10)
PLACE = np.array([12.0, 12.0, 20.0])  # mm, of the heart: to the left, back, up
MEASURES = {"height": 0.09, "girth": 0.15, "depth": 0.1, "shoulders": 0.1, "hips": 0.1}
# mm, of electrodes across the skin, which the deformation may take up; along it on the chest, and
# where limbs join the trunk, as limb electrodes are anywhere from there to the wrist
ACROSS, ALONG, ALONG_LIMBS = 5.0, 25.0, 50.0
SKIN_TO_HEART, SKIN_TO_HEART_SD = 32.0, 8.0  # mm; only less than that is penalised
OUTLIER = 3.0  # standard deviations beyond which a residual counts less and less
MOST = 3.0  # standard deviations, of tilt and measures

FURTHEST_PLACE = 80.0  # mm, of the heart from its usual place
FARTHEST = 60.0  # mm, of an electrode from the fitted skin, which the deformation can take up
SMOOTH = 80.0  # mm, over which the deformation falls off
BISECTIONS = 30
SLOPE_STEP = 0.5  # mm, for the slope of a level set
NEWTON_STEPS = 10  # from an electrode to the skin
LEAST_SLOPE = 1e-3
STANDARD = BodySize()


@dataclass(frozen=True)
class FittedTrunk:
    """An idealised trunk fitted to electrodes.

    Attributes
    ----------
    body : BodySize
        Its measures.
    frame : BodyFrame
        Where it lies around the heart.
    electrodes : (9, 3) array
        As given, in the body frame (mm).
    sites : (9, 3) array
        The standard sites on this trunk, before it was deformed, likewise.
    on_skin : (9, 3) array
        Points of the skin, before it was deformed, that the deformation puts at the electrodes.
    """

    body: BodySize
    frame: BodyFrame
    electrodes: Floats
    sites: Floats
    on_skin: Floats

    @property
    def moved(self) -> Floats:
        """How far the deformation moves the skin at each electrode (mm); (9,)."""
        return np.asarray(np.linalg.norm(self.on_skin - self.electrodes, axis=1))

    @cached_property
    def _displacement(self) -> RBFInterpolator:
        """Of least norm; inverse multiquadrics fall off, so far away nothing moves."""
        return RBFInterpolator(
            self.electrodes,
            self.on_skin - self.electrodes,
            kernel="inverse_multiquadric",
            epsilon=1 / SMOOTH,
            degree=-1,
        )

    def undeformed(self, points: Floats) -> Floats:
        """Where points (n, 3) of the body frame lie in the trunk before it was deformed (mm)."""
        return np.asarray(points + self._displacement(points))


def fit_trunk(
    name: str,
    electrodes: Floats,
    heart: Floats,
    centroid: Floats,
    rotation: Floats,
    known: Mapping[str, float],
) -> FittedTrunk:
    """Find the most probable trunk for electrodes and heart.

    Parameters
    ----------
    name : str
        What to call the electrodes in an error.
    electrodes : (9, 3) array
        In the heart's coordinates (mm), in the order of `fascicle.core.leads.ELECTRODES`.
    heart : (n, 3) array
        Points of the heart's surface (mm).
    centroid : (3,) array
        Of the myocardium, in the heart's coordinates (mm).
    rotation : (3, 3) array
        Its columns are the body's axes in the heart's coordinates; they are tilted a little.
    known : mapping of name to float
        Measures of the person, arguments of `BodySize`, which are kept.

    Raises
    ------
    InputError
        If the heart is nowhere near its place among the electrodes, or an electrode is far from any
        adult's skin.
    """
    problem = _Problem(electrodes, heart[ConvexHull(heart).vertices], centroid, rotation, known)
    most = np.array([MOST] * 3 + [np.inf] * 3 + [MOST] * len(problem.free))
    # an electrode at an odd place hardly counts, so that the others tell how odd it is
    found = least_squares(
        problem.residuals, np.zeros(len(most)), bounds=(-most, most), loss="cauchy", f_scale=OUTLIER
    )
    body, frame = problem.body(found.x), problem.frame(found.x)
    _check_place(name, PLACE * found.x[3:6])
    placed, outside = frame.to_body(electrodes), outside_trunk(body)
    fitted = FittedTrunk(body, frame, placed, leaving(outside, body), _nearest(outside, placed))
    worst = int(np.argmax(fitted.moved))
    if fitted.moved[worst] > FARTHEST:
        raise InputError(
            f"{name}: electrode {ELECTRODES[worst]} is {fitted.moved[worst]:.0f} mm from the skin "
            "of any adult's trunk that fits the others; check its position (limb electrodes: where "
            "the limbs join the trunk), or give the person's own skin (--torso FILE)"
        )
    return fitted


@dataclass(frozen=True)
class _Problem:
    """Nonlinear least squares for tilt, place and measures, all in standard deviations."""

    electrodes: Floats
    hull: Floats
    centroid: Floats
    rotation: Floats
    known: Mapping[str, float]

    @cached_property
    def free(self) -> list[str]:
        """Measures that nobody knows."""
        given = set(self.known) | ({"girth"} if {"chest", "weight"} & set(self.known) else set())
        return [name for name in MEASURES if name not in given]

    def body(self, x: Floats) -> BodySize:
        """The trunk's measures; the logarithms of unknown ones are fitted."""
        factors = {
            name: float(np.exp(MEASURES[name] * step))
            for name, step in zip(self.free, x[6:], strict=True)
        }
        girth = factors.pop("girth", None)
        values = {"height": STANDARD.height, **self.known}
        values |= {name: values.get(name, 1.0) * factor for name, factor in factors.items()}
        if girth is not None:
            values["chest"] = girth * STANDARD.girth
        return BodySize(**values)

    def frame(self, x: Floats) -> BodyFrame:
        """Where that trunk lies: tilt about its axes, then the heart off its usual place."""
        rotation = self.rotation @ Rotation.from_rotvec(TILT * x[:3]).as_matrix()
        place = default_position(self.body(x)) + PLACE * x[3:6]
        return BodyFrame(rotation, self.centroid - rotation @ place)

    def residuals(self, x: Floats) -> Floats:
        """Electrodes off the skin and off their sites; heart near the skin; measures and pose."""
        body, frame = self.body(x), self.frame(x)
        outside = outside_trunk(body)
        placed = frame.to_body(self.electrodes)
        off_site = placed - leaving(outside, body)
        off_site[:V1] /= ALONG_LIMBS
        off_site[V1:] /= ALONG
        gap = -outside(frame.to_body(self.hull)).max()
        near = min(gap - SKIN_TO_HEART, 0.0) / SKIN_TO_HEART_SD
        return np.concatenate([outside(placed) / ACROSS, off_site.ravel(), [near], x])


def leaving(outside: Outside, body: BodySize) -> Floats:
    """Standard sites (9, 3) on a trunk's level set (mm), by bisection along their rays."""
    starts, directions = site_rays(body)
    low = np.zeros(len(starts))
    high = np.full(len(starts), 2 * WIDEST * body.half_width)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        inside = outside(starts + middle[:, None] * directions) < 0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return np.asarray(starts + low[:, None] * directions)


def _nearest(outside: Outside, points: Floats) -> Floats:
    """Points of a level set near given ones (n, 3), by Newton's steps down its slope."""
    points = points.copy()
    steps = SLOPE_STEP * np.concatenate([np.eye(3), -np.eye(3)])
    for _ in range(NEWTON_STEPS):
        around = np.stack([outside(points + step) for step in steps], axis=1)
        slope = (around[:, :3] - around[:, 3:]) / (2 * SLOPE_STEP)
        square = np.maximum((slope**2).sum(axis=1), LEAST_SLOPE)
        points -= (outside(points) / square)[:, None] * slope
    return points


def _check_place(name: str, shift: Floats) -> None:
    """Refuse a heart that lies far from its usual place; shift in the body frame (mm)."""
    axis = int(np.argmax(np.abs(shift)))
    if abs(shift[axis]) > FURTHEST_PLACE:
        way = (("right", "left"), ("front", "back"), ("feet", "head"))[axis][int(shift[axis] > 0)]
        raise InputError(
            f"{name}: the heart lies {abs(shift[axis]):.0f} mm too far to the {way} for these "
            "electrodes, so they are not in the heart's frame; give both in one frame, in mm"
        )
