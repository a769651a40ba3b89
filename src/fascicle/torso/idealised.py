"""Idealised adult torso around a heart: of standard shape, or fitted to electrodes on its skin.

If electrodes are given, the size of the trunk and its pose around heart and electrodes are fitted
first, by maximum a posteriori: electrodes are on the skin and near their standard sites, the heart
is near its default position, measures are those of adults. Then the smallest smooth deformation of
skin, ribs and lungs closes the gaps that remain between skin and electrodes.

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
from fascicle.heart.labelled_surface import LabelledMesh
from fascicle.mesh.measures import solid_centroid
from fascicle.torso.electrode_sites import Electrode, site_rays, standard_electrodes
from fascicle.torso.heart_pose import (
    Pose,
    TorsoFrame,
    axes_of_electrodes,
    check_apex,
    default_position,
    endocardial_surfaces,
    opening,
    torso_frame,
)
from fascicle.torso.surfaces import Surface, TorsoSurfaces, check_within, signed_distance
from fascicle.torso.trunk import (
    Deformation,
    Outside,
    TrunkSize,
    convex_hull,
    exclusion_hull,
    identity,
    lungs_of,
    outside_trunk,
    skin_of,
    smooth_max,
    trunk,
    trunk_box,
)

FITTED = "fitted to the electrodes"  # key of lead fields whose torso is not in the heart's folder
SKIN_MARGIN = 5.0  # mm that must remain between heart and skin
FARTHEST_ELECTRODE = 60.0  # mm from the fitted skin, the most that the deformation can close


def idealised_torso(
    mesh: LabelledMesh, size: TrunkSize | None = None, pose: Pose | TorsoFrame = "standard"
) -> TorsoSurfaces:
    """Put an idealised adult torso around a heart (mm), which does not move.

    The trunk is that of a standard adult if none is given; the pose is that of
    `fascicle.torso.heart_pose.torso_frame`, or a frame of your own. An error if the heart does not
    fit into that torso, leaves no room for the lungs, or is not closed.
    """
    size = size if size is not None else TrunkSize()
    frame = pose if isinstance(pose, TorsoFrame) else torso_frame(mesh, size, pose)
    skin = trunk(size)
    return _with_lungs(mesh, size, frame, skin, frame.to_heart(standard_electrodes(size, skin)))


def fitted_torso(
    mesh: LabelledMesh,
    electrodes: Floats,
    name: str,
    measures: Mapping[str, float],
    pose: Pose = "standard",
) -> tuple[TorsoSurfaces, FittedTrunk]:
    """Put an idealised torso around a heart (mm), with given electrodes on its skin.

    Electrodes (9, 3), called `name` in errors, are in the heart's coordinates (mm). The
    person's `measures`, arguments of `TrunkSize`, are kept. In the "standard" pose the
    torso's axes follow from the electrodes, else they are those of the image that the heart comes
    from; both are tilted a little where that fits better.
    """
    standard = TrunkSize()
    if pose == "standard":
        rotation = axes_of_electrodes(electrodes, standard_electrodes(standard, trunk(standard)))
        check_apex(f"{name}: by the electrodes' places", rotation, *endocardial_surfaces(mesh))
    else:
        rotation = torso_frame(mesh, standard, pose).rotation
    heart = mesh.vertices[np.unique(mesh.triangles)]
    centroid = solid_centroid(mesh.vertices, mesh.tetrahedra)
    fitted = fit_trunk(name, electrodes, heart, centroid, rotation, measures)
    placed = fitted.frame.to_torso(heart)
    hull = convex_hull(placed)
    undeformed_trunk = outside_trunk(fitted.size)
    reach = 4 * SKIN_MARGIN  # elsewhere the heart makes no difference
    low, high = placed.min(axis=0) - reach, placed.max(axis=0) + reach

    def outside(points: Floats) -> Floats:
        of_trunk = undeformed_trunk(fitted.undeformed(points))
        near = ((points > low) & (points < high)).all(axis=1) & (of_trunk > -reach)
        of_heart = signed_distance(points[near], hull) - 2 * SKIN_MARGIN
        of_trunk[near] = -smooth_max(-of_trunk[near], -of_heart, SKIN_MARGIN)
        return of_trunk

    skin = skin_of(outside, trunk_box(fitted.size, FARTHEST_ELECTRODE))
    return _with_lungs(mesh, fitted.size, fitted.frame, skin, electrodes, fitted.undeformed), fitted


def _with_lungs(
    mesh: LabelledMesh,
    size: TrunkSize,
    frame: TorsoFrame,
    skin: Surface,
    electrodes: Floats,
    undeformed: Deformation = identity,
) -> TorsoSurfaces:
    """Add lungs to a skin in the torso frame; electrodes are in the heart's coordinates."""
    heart = frame.to_torso(mesh.vertices[np.unique(mesh.triangles)])
    beyond = signed_distance(heart, skin) + SKIN_MARGIN
    if beyond.max() > 0:
        x, y, z = heart[np.argmax(beyond)]
        raise InputError(
            f"{mesh.name}: does not fit into the idealised torso, {beyond.max():.0f} mm too far "
            f"out ({'left' if x > 0 else 'right'} {'front' if y < 0 else 'back'} "
            f"{'above' if z > 0 else 'below'} V1); check pose and units, or give a larger height, "
            "weight or chest girth"
        )
    base = frame.to_torso(np.stack([opening(side) for side in endocardial_surfaces(mesh)]))
    lungs = lungs_of(mesh.name, size, exclusion_hull(heart, base), undeformed)
    outer, *inner = (Surface(frame.to_heart(s.vertices), s.triangles) for s in (skin, *lungs))
    check_within(mesh, outer, inner)
    return TorsoSurfaces(outer, tuple(inner), electrodes)


@dataclass(frozen=True)
class FittedTrunk:
    """An idealised trunk fitted to electrodes: its measures, and where it lies around the heart.

    Positions (9, 3) are in the torso frame (mm): the given electrodes, standard sites on the trunk
    before it was deformed, and points of that skin that the deformation moves to the electrodes.
    """

    size: TrunkSize
    frame: TorsoFrame
    electrodes: Floats
    sites: Floats
    on_skin: Floats

    @property
    def moved(self) -> Floats:
        """Distances (9,) by which the deformation moves the skin at the electrodes (mm)."""
        return np.asarray(np.linalg.norm(self.on_skin - self.electrodes, axis=1))

    @cached_property
    def _displacement(self) -> RBFInterpolator:
        """Least-norm displacement, of inverse multiquadrics that fall off over 80 mm."""
        moved = self.on_skin - self.electrodes
        return RBFInterpolator(
            self.electrodes, moved, kernel="inverse_multiquadric", epsilon=1 / 80.0, degree=-1
        )

    def undeformed(self, points: Floats) -> Floats:
        """Positions in the undeformed trunk of points (n, 3) of the torso frame (mm)."""
        return np.asarray(points + self._displacement(points))


def fit_trunk(
    name: str,
    electrodes: Floats,
    heart: Floats,
    centroid: Floats,
    rotation: Floats,
    measures: Mapping[str, float],
) -> FittedTrunk:
    """Find the most probable trunk for electrodes (9, 3), called `name`.

    Nonlinear least squares for tilt (3,), position (3,) and measures, all in standard deviations.
    Points (n, 3) of the heart's surface and the myocardium's centroid (3,) are in the heart's
    coordinates (mm), as the torso's axes, the columns of `rotation`, which are tilted a little; see
    `fitted_torso` for the `measures`.
    """
    hull = heart[ConvexHull(heart).vertices]
    # standard deviations of the fitted quantities: tilt (rad), position of the heart to the left,
    # back and up (mm), and the logarithms of the measures
    tilt, spread = np.radians(10), np.array([12.0, 12.0, 20.0])
    deviations = {"height": 0.09, "girth": 0.15, "depth": 0.1, "shoulders": 0.1, "hips": 0.1}
    fixed = set(measures) | ({"girth"} if {"chest", "weight"} & set(measures) else set())
    unknown = [measure for measure in deviations if measure not in fixed]

    def trunk_of(x: Floats) -> tuple[TrunkSize, TorsoFrame]:
        """Measures and frame of a trunk: tilted about its axes, then moved around the heart."""
        steps = zip(unknown, x[6:], strict=True)
        factors = {measure: float(np.exp(deviations[measure] * step)) for measure, step in steps}
        girth = factors.pop("girth", None)
        values = {"height": TrunkSize.height, **measures}
        values |= {measure: values.get(measure, 1.0) * f for measure, f in factors.items()}
        if girth is not None:
            values["chest"] = girth * TrunkSize().girth
        size = TrunkSize(**values)
        tilted = rotation @ Rotation.from_rotvec(tilt * x[:3]).as_matrix()
        position = default_position(size) + spread * x[3:6]
        return size, TorsoFrame(tilted, centroid - tilted @ position)

    def residuals(x: Floats) -> Floats:
        """Distances of electrodes to skin and sites, and of heart to skin; measures and pose."""
        size, frame = trunk_of(x)
        outside, placed = outside_trunk(size), frame.to_torso(electrodes)
        # across the skin, 5 mm, which the deformation may take up; along it, 25 mm on the chest,
        # and 50 where limbs join the trunk, as those electrodes are anywhere down to the wrist
        off_site = placed - leaving(outside, size)
        off_site[: Electrode.V1] /= 50.0
        off_site[Electrode.V1 :] /= 25.0
        gap = -outside(frame.to_torso(hull)).max()
        near = min(gap - 32.0, 0.0) / 8.0  # mm, of skin to heart; only a small gap is penalised
        return np.concatenate([outside(placed) / 5.0, off_site.ravel(), [near], x])

    most = np.array([3.0] * 3 + [np.inf] * 3 + [3.0] * len(unknown))
    # the loss grows slowly beyond three standard deviations, so that a misplaced electrode hardly
    # pulls on the fit to the others
    fit = least_squares(
        residuals, np.zeros(len(most)), bounds=(-most, most), loss="cauchy", f_scale=3.0
    )
    shift = spread * fit.x[3:6]
    axis = int(np.argmax(np.abs(shift)))
    if abs(shift[axis]) > 80:  # mm
        way = (("right", "left"), ("front", "back"), ("feet", "head"))[axis][int(shift[axis] > 0)]
        raise InputError(
            f"{name}: the heart lies {abs(shift[axis]):.0f} mm too far to the {way} for these "
            "electrodes, so they are not in the heart's frame; give both in one frame, in mm"
        )
    size, frame = trunk_of(fit.x)
    placed, outside = frame.to_torso(electrodes), outside_trunk(size)
    fitted = FittedTrunk(size, frame, placed, leaving(outside, size), _nearest(outside, placed))
    worst = int(np.argmax(fitted.moved))
    if fitted.moved[worst] > FARTHEST_ELECTRODE:
        raise InputError(
            f"{name}: electrode {ELECTRODES[worst]} is {fitted.moved[worst]:.0f} mm from the skin "
            "of any adult's trunk that fits the others; check its position (limb electrodes: where "
            "the limbs join the trunk), or give the person's own skin (--torso FILE)"
        )
    return fitted


def leaving(outside: Outside, size: TrunkSize) -> Floats:
    """Standard sites (9, 3) on a trunk's level set (mm), by bisection along their rays."""
    starts, directions = site_rays(size)
    low = np.zeros(len(starts))
    high = np.full(len(starts), 2 * size.widest * size.half_width)
    for _ in range(30):
        middle = (low + high) / 2
        inside = outside(starts + middle[:, None] * directions) < 0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return np.asarray(starts + low[:, None] * directions)


def _nearest(outside: Outside, points: Floats) -> Floats:
    """Points of a level set near points (n, 3), by Newton steps along its gradient."""
    points = points.copy()
    step = 0.5  # mm, for the slope
    steps = step * np.concatenate([np.eye(3), -np.eye(3)])
    for _ in range(10):
        around = np.stack([outside(points + away) for away in steps], axis=1)
        slope = (around[:, :3] - around[:, 3:]) / (2 * step)
        points -= (outside(points) / np.maximum((slope**2).sum(axis=1), 1e-3))[:, None] * slope
    return points
