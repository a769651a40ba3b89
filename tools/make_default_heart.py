"""Make the packaged default heart: an idealised adult, built as a user's anatomy would be.

    python tools/make_default_heart.py FOLDER

A label map is drawn from ellipsoids: the left ventricle is the shell between two truncated
ellipsoids of revolution, the right one a shell around a third ellipsoid that is leant against it,
so that its cavity is a crescent. From there on it goes the way of every segmentation: surface,
mesh, rule-based fibres, idealised torso, lead fields.

Frames (mm). Heart frame: origin in the middle of the LV base, z along the LV axis from apex to
base, x from the LV towards the RV, y to the anterior-superior side of the septum. Body frame: x to
the patient's left, y to the back, z to the head.

Sources
-------
Volumes and mass : Petersen et al. 2017, J Cardiovasc Magn Reson 19:18 (UK Biobank reference ranges:
    LV end-diastolic volume 124 and 166 ml, LV mass 70 and 103 g, RV end-diastolic volume 130 and
    182 ml, means of women and of men). This heart's cavities are those of a small adult; its LV,
    129 ml or 135 g at 1.05 g/ml, is heavier than these means, for the wall thickness below is
    taken at the upper end of its range.
Wall thickness : Lang et al. 2015, J Am Soc Echocardiogr 28:1-39 (LV 6-10 mm, LV internal diameter
    38-58 mm, RV free wall below 5 mm). The thinning towards the apex is common knowledge.
Pose : `fascicle.torso.heart_pose`, standard.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fascicle.build.build_heart import heart_of
from fascicle.build.labelled_files import Anatomy
from fascicle.build.meshing import mesh_surface
from fascicle.build.segmentation import Segmentation, SegmentationLabels
from fascicle.build.segmentation_surface import surface_from_segmentation
from fascicle.build.torso import TorsoOptions, in_torso
from fascicle.heart.endocardium import ChosenSeed
from fascicle.heart.folder import write_heart
from fascicle.heart.heart import Heart, LeadFields
from fascicle.torso.heart_pose import standard_axes

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Ellipsoid:
    """Ellipsoid in the heart frame: centre and semi-axes in mm, tilt about y in rad."""

    centre: tuple[float, float, float]
    semi_axes: tuple[float, float, float]
    tilt: float = 0.0

    def holds(self, points: Floats) -> NDArray[np.bool_]:
        """Tell which points (..., 3) lie in it."""
        c, s = np.cos(self.tilt), np.sin(self.tilt)
        to_own_axes = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        own = (points - self.centre) @ to_own_axes.T / self.semi_axes
        return np.asarray(np.linalg.norm(own, axis=-1) < 1)

    def grown(self, thickness: float) -> Ellipsoid:
        """Return the ellipsoid with semi-axes longer by the thickness."""
        longer = tuple(length + thickness for length in self.semi_axes)
        return Ellipsoid(self.centre, longer, self.tilt)


# The base plane z = 0 lies 18 mm above the widest section: the cavity narrows towards the valves.
LV_INNER = Ellipsoid((0, 0, -18), (24.5, 24.5, 68))
LV_OUTER = Ellipsoid((0, 0, -18), (34.2, 34.2, 74.5))
RV_INNER = Ellipsoid((30, 0, -16), (35.5, 37.5, 58), tilt=np.radians(13))
RV_OUTER = RV_INNER.grown(4.4)

SPACING = 0.75  # mm, of the label map
LOW, HIGH = np.array([-38.0, -46.0, -96.0]), np.array([78.0, 46.0, 0.0])  # of the map, mm
EDGE = 3.0  # mm; two layers of tetrahedra in the RV wall
HEART_CENTRE = np.array([33.0, -37.0, -5.0])  # of the map's muscle, in the body frame

# Roots and directions of the bundles (heart frame, mm), on the front upper part of the septum,
# where they come out under the aortic valve. The ellipsoids are symmetric, so that a rule that goes
# by the shape alone might as well choose the other side.
SEEDS = {
    "lv": ((12.0, 21.2, -9.8), (11.9, 19.6, -41.8)),
    "rv": ((20.4, 27.3, -12.5), (15.8, 28.6, -36.2)),
}

# What keeps the file small: positions and fibres are rounded to these, which zlib squeezes
POSITION_STEP, FIBRE_STEP = 2.0**-10, 2.0**-12


def label_map() -> Segmentation:
    """Draw LV blood (1), RV blood (2) and muscle (3); voxel indices to the body frame."""
    count = np.round((HIGH - LOW) / SPACING).astype(int)
    axes = [LOW[k] + (np.arange(count[k]) + 0.5) * SPACING for k in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    lv = LV_INNER.holds(points)
    outer = LV_OUTER.holds(points)
    rv = RV_INNER.holds(points) & ~outer
    labels = np.where(lv, 1, np.where(rv, 2, np.where(outer | RV_OUTER.holds(points), 3, 0)))
    affine = np.eye(4)
    affine[:3, :3] = standard_axes() * SPACING
    first = np.array([axis[0] for axis in axes])
    affine[:3, 3] = to_body(first, points[labels == 3].mean(axis=0))
    return Segmentation(labels, affine, "idealised adult heart")


def to_body(point: Floats, centre: Floats) -> Floats:
    """A point of the heart frame, where the map's muscle has this centre, in the body frame."""
    return HEART_CENTRE + standard_axes() @ (point - centre)


def seeds_in_body(drawn: Segmentation) -> dict[str, tuple[ChosenSeed, ChosenSeed]]:
    """`SEEDS` in the body frame."""
    turn, first = standard_axes(), LOW + SPACING / 2
    placed = {
        side: [drawn.affine[:3, 3] + turn @ (np.array(point) - first) for point in pair]
        for side, pair in SEEDS.items()
    }
    return {
        side: ((x.item(0), x.item(1), x.item(2)), (y.item(0), y.item(1), y.item(2)))
        for side, (x, y) in placed.items()
    }


def make_heart() -> Heart:
    """Build the heart with what is small enough to be packaged: no sheets, no torso mesh."""
    drawn = label_map()
    surface, _ = surface_from_segmentation(drawn, SegmentationLabels())
    mesh = mesh_surface(surface, EDGE)
    mesh = replace(mesh, vertices=rounded(mesh.vertices, POSITION_STEP))
    heart = heart_of(Anatomy(mesh), seeds=seeds_in_body(drawn), name="idealised adult heart")
    fibres = rounded(heart.fibres, FIBRE_STEP)
    # as they will be when the file is read
    heart = replace(heart, fibres=fibres / np.linalg.norm(fibres, axis=1, keepdims=True))
    heart, _ = in_torso(heart, mesh, TorsoOptions(pose="lps"))
    assert heart.lead_fields is not None
    single = heart.lead_fields.values.astype(np.float32).astype(float)
    return replace(
        heart,
        fibres=fibres,
        sheets=None,
        torso=None,
        lead_fields=LeadFields(single, heart.lead_fields.key, torso=""),
    )


def rounded(values: Floats, step: float) -> Floats:
    """Values to the nearest multiple of a step."""
    return np.round(values / step) * step


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the packaged default heart.")
    parser.add_argument("folder", type=Path, help="where the files go")
    folder = parser.parse_args().folder
    heart = make_heart()
    write_heart(heart, folder)
    print(f"{len(heart.vertices)} vertices, {len(heart.tetrahedra)} tetrahedra in {folder}")


if __name__ == "__main__":
    main()
