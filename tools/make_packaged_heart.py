"""Make a packaged heart, built as a user's anatomy would be.

    python tools/make_packaged_heart.py default FOLDER
    python tools/make_packaged_heart.py camps-dti004 FOLDER --published PUBLISHED

`camps-dti004` is one subject's ventricles (Camps et al. 2024, Med Image Anal,
doi:10.1016/j.media.2024.103361; MIT licence), meshed again with edges of 2.6 mm, with the published
fibres and electrodes, and that subject's own averaged beat. The folder PUBLISHED holds `mesh.vtu`
(mm, with the fibres as point array), `electrodes.csv` and `ecg_beat.csv` (microvolt).

`default` is an idealised adult. A label map is drawn from ellipsoids: the left ventricle is the
shell between two truncated ellipsoids of revolution, the right one a shell around a third ellipsoid
that is leant against it, so that its cavity is a crescent. From there on it goes the way of every
segmentation: surface, mesh, rule-based fibres, idealised torso, lead fields.

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

import igl
import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

from fascicle.build import meshing
from fascicle.build.build_heart import Seeds, TorsoOptions, heart_of, in_torso
from fascicle.build.labelled_files import Anatomy
from fascicle.build.read_anatomy import Source, read_anatomy
from fascicle.build.segmentation import Segmentation, SegmentationLabels
from fascicle.build.segmentation_surface import surface_from_segmentation
from fascicle.build.surface_repair import compacted
from fascicle.heart.endocardium import ChosenSeed
from fascicle.heart.folder import HEART_FILES, write_heart
from fascicle.heart.heart import Heart, LeadFields
from fascicle.heart.labelled_surface import LabelledMesh, LabelledSurface
from fascicle.torso.heart_pose import standard_axes
from fascicle.torso.idealised import FITTED

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
        to_axes = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        scaled = (points - self.centre) @ to_axes.T / self.semi_axes
        return np.asarray(np.linalg.norm(scaled, axis=-1) < 1)

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
CAMPS_EDGE = 2.6  # mm
# Example networks, of the prior of human anatomy and activated as mapped hearts are: of 1200 random
# ones on the idealised heart one with an ECG within normal limits, and left bundle branch block
# where the left network is late; of a posterior of the subject's beat one that explains most of it.
IDEALISED_EXAMPLE = {
    "lv_initial_length": 14.9, "rv_initial_length": 49.3, "lv_fascicle_length_1": 40.1,
    "lv_fascicle_length_2": 9.6, "lv_fascicle_length_3": 43.4, "rv_fascicle_length_1": 13.1,
    "rv_fascicle_length_2": 10.6, "lv_fascicle_direction_1": 0.9, "lv_fascicle_direction_2": -0.54,
    "lv_fascicle_direction_3": -1.08, "rv_fascicle_angle_1": -1.84, "rv_fascicle_angle_2": 1.5,
    "interventricular_delay": 4.2, "cv": 2.35, "fibre_speed": 0.66, "rv_source": 0.3,
}  # fmt: skip
CAMPS_EXAMPLE = {
    "lv_initial_length": 8.279, "rv_initial_length": 35.3, "lv_fascicle_length_1": 21.32,
    "lv_fascicle_length_2": 7.865, "lv_fascicle_length_3": 23.48, "rv_fascicle_length_1": 11.96,
    "rv_fascicle_length_2": 12.29, "lv_fascicle_direction_1": 1.002,
    "lv_fascicle_direction_2": 0.6211, "lv_fascicle_direction_3": -0.8919,
    "rv_fascicle_angle_1": -1.7, "rv_fascicle_angle_2": 1.153, "interventricular_delay": 5.718,
    "cv": 2.395, "fibre_speed": 0.5056, "anterograde_delay": 1.462, "axial_source": 0.3241,
    "branch_angle": 0.1857, "branch_length": 8.048, "repulsion": 0.1044, "rv_source": 0.2524,
}  # fmt: skip
HEART_CENTRE = np.array([33.0, -37.0, -5.0])  # of the map's muscle, in the body frame

# Roots and directions of the bundles (heart frame, mm), in the upper septum under the aortic valve,
# as far round the long axis as those that are published with camps-dti004: the left one in the
# middle, the right one on the way to the anterior papillary muscle, 40 degrees in front of it.
SEEDS = {
    "lv": ((24.3, 2.0, -12.0), (22.3, 4.1, -43.7)),
    "rv": ((26.7, 21.4, -13.6), (28.0, 15.9, -42.9)),
}

# Positions and fibres are rounded to these, so that zlib makes the file small
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


def idealised_heart() -> Heart:
    """The heart of the label map."""
    drawn = label_map()
    surface, _ = surface_from_segmentation(drawn, SegmentationLabels())
    mesh = with_rounded_vertices(meshing.mesh_surface(surface, EDGE))
    seeds, name = seeds_in_body(drawn), "idealised adult heart"
    heart = small(Anatomy(mesh), seeds, name, TorsoOptions(pose="lps"))
    return replace(heart, example=IDEALISED_EXAMPLE)


def camps_heart(published: Path) -> Heart:
    """The published heart with fewer vertices; its bundles start where they do in the finer one."""
    source = read_anatomy(Source(file=published / "mesh.vtu", parts={}), CAMPS_EDGE, None)
    before, fibres = source.mesh, source.fibres
    assert fibres is not None
    # one wall of this heart is thinner than two edges: a run within 15 ms wants a coarse mesh
    mesh = with_rounded_vertices(meshing.filled(with_separate_walls(before), CAMPS_EDGE))
    near, weights = meshing.nearest_tetrahedra(before, mesh)
    anatomy = Anatomy(mesh, fibres=meshing.mean_axes(fibres[near], weights))
    seeds: Seeds = {
        side: (
            place(endocardium.vertices[endocardium.root]),
            place(endocardium.vertices[endocardium.direction]),
        )
        for side, endocardium in zip(("lv", "rv"), heart_of(source).endocardia, strict=True)
    }
    body = TorsoOptions(electrodes=published / "electrodes.csv")
    return replace(small(anatomy, seeds, "camps-dti004", body), example=CAMPS_EXAMPLE)


def with_separate_walls(mesh: LabelledMesh) -> LabelledSurface:
    """The surface of a mesh; where two walls meet in a vertex, each is moved outwards by 1 mm."""
    surface = compacted(LabelledSurface(mesh.vertices, mesh.triangles, mesh.labels, mesh.name))
    triangles, parent = igl.split_nonmanifold(surface.triangles)[:2]
    vertices = surface.vertices[parent]
    doubled = np.bincount(parent)[parent] > 1
    vertices[doubled] += igl.per_vertex_normals(vertices, triangles)[doubled]
    return LabelledSurface(vertices, triangles, surface.labels, surface.name)


def place(point: Floats) -> ChosenSeed:
    return point.item(0), point.item(1), point.item(2)


def with_rounded_vertices(mesh: LabelledMesh) -> LabelledMesh:
    return replace(mesh, vertices=rounded(mesh.vertices, POSITION_STEP))


def small(anatomy: Anatomy, seeds: Seeds, name: str, body: TorsoOptions) -> Heart:
    """A heart that is small enough to be packaged: without sheets and torso mesh."""
    heart = heart_of(anatomy, seeds=seeds, name=name)
    fibres = rounded(heart.fibres, FIBRE_STEP)
    # as they will be when the file is read
    heart = replace(heart, fibres=fibres / np.linalg.norm(fibres, axis=1, keepdims=True))
    heart, _ = in_torso(heart, anatomy.mesh, body)
    assert heart.lead_fields is not None
    single = heart.lead_fields.values.astype(np.float32).astype(float)
    return replace(
        heart,
        fibres=fibres,
        sheets=None,
        torso=None,
        lead_fields=LeadFields(single, heart.lead_fields.key, FITTED if body.electrodes else ""),
    )


def rounded(values: Floats, step: float) -> Floats:
    """Values to the nearest multiple of a step."""
    return np.round(values / step) * step


def without_text(path: Path) -> None:
    """Write a mesh again with its numbers as they are, not as text: a quarter smaller."""
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetInputData(pv.read(path))
    writer.SetFileName(str(path))
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    writer.SetCompressorTypeToZLib()
    writer.SetCompressionLevel(9)
    writer.Write()


def main() -> None:
    parser = argparse.ArgumentParser(description="Make a packaged heart.")
    parser.add_argument("heart", choices=("default", "camps-dti004"))
    parser.add_argument("folder", type=Path, help="where the files go")
    parser.add_argument("--published", type=Path, help="folder of the published files")
    arguments = parser.parse_args()
    published = arguments.published
    heart = idealised_heart() if arguments.heart == "default" else camps_heart(published)
    write_heart(heart, arguments.folder)
    without_text(arguments.folder / HEART_FILES["mesh"])
    if published is not None:
        names, numbers = (published / "ecg_beat.csv").read_text().split("\n", 1)
        time, *leads = names.split(",")
        titles = ",".join([time, *(f"{lead}_uV" for lead in leads)])
        (arguments.folder / "ecg.csv").write_text(f"{titles}\n{numbers}")
    print(
        f"{len(heart.vertices)} vertices, {len(heart.tetrahedra)} tetrahedra in {arguments.folder}"
    )


if __name__ == "__main__":
    main()
