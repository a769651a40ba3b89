"""Make the packaged default heart: an idealised adult biventricular geometry.

    python tools/make_default_heart.py FOLDER

The left ventricle is the shell between two truncated ellipsoids of revolution, the right one a thin
shell around a third ellipsoid that is leant against it, so that its cavity is a crescent. Gmsh's
OpenCASCADE kernel builds and meshes the solid; rule-based fibres follow from Laplace problems; the
heart is then turned into its place in a torso-sized hull that carries the nine electrodes.

Frames (mm). Heart frame: origin in the middle of the LV base, z along the LV axis from apex to
base, x from the LV towards the RV, y to the anterior-superior side of the septum. Torso frame: x to
the patient's left, y to the back, z to the head, origin on the torso's axis at the level of V1.

Sources
-------
Volumes and mass : Petersen et al. 2017, J Cardiovasc Magn Reson 19:18 (UK Biobank reference ranges:
    LV end-diastolic volume 124 and 166 ml, LV mass 70 and 103 g, RV end-diastolic volume 130 and
    182 ml, means of women and of men). This heart's cavities are those of a small adult; its LV,
    129 ml or 135 g at 1.05 g/ml, is heavier than these means, for the wall thickness below is
    taken at the upper end of its range.
Wall thickness : Lang et al. 2015, J Am Soc Echocardiogr 28:1-39 (LV 6-10 mm, LV internal diameter
    38-58 mm, RV free wall below 5 mm). The thinning towards the apex is common knowledge.
Pose : the cardiac long axis points left, anterior and down, at about 45 degrees to the three body
    planes; common anatomical knowledge.
Fibres : Streeter et al. 1969, Circ Res 24:339-347 (+60 degrees at the endocardium to -60 at the
    epicardium); the Laplace construction follows Bayer et al. 2012, Ann Biomed Eng 40:2243-2254.
Electrodes : Kligfield et al. 2007, Circulation 115:1306-1324 (sites); Mason and Likar 1966,
    Am Heart J 71:196-205 (limb electrodes moved to the trunk).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import gmsh
import numpy as np
import skfem
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skfem.models.poisson import laplace as stiffness

from fascicle.geometry.endocardium import Endocardium
from fascicle.geometry.heart import Heart
from fascicle.io.hearts import write_heart
from fascicle.leads import ELECTRODES

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Ellipsoid:
    """Ellipsoid in the heart frame: centre and semi-axes in mm, tilt about y in rad."""

    centre: tuple[float, float, float]
    semi_axes: tuple[float, float, float]
    tilt: float = 0.0

    def level(self, points: Floats) -> Floats:
        """Relative radius of points (..., 3): below 1 inside, 1 on the surface."""
        c, s = np.cos(self.tilt), np.sin(self.tilt)
        to_own_axes = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        return np.linalg.norm((points - self.centre) @ to_own_axes.T / self.semi_axes, axis=-1)

    def grown(self, thickness: float) -> Ellipsoid:
        """Return the ellipsoid with semi-axes longer by the thickness."""
        longer = tuple(length + thickness for length in self.semi_axes)
        return Ellipsoid(self.centre, longer, self.tilt)

    def add(self) -> tuple[int, int]:
        """Add the solid to the Gmsh model and return its (dimension, tag)."""
        occ = gmsh.model.occ
        solid = (3, occ.addSphere(0, 0, 0, 1))
        occ.dilate([solid], 0, 0, 0, *self.semi_axes)
        occ.rotate([solid], 0, 0, 0, 0, 1, 0, self.tilt)
        occ.translate([solid], *self.centre)
        return solid


# The base plane z = 0 lies 18 mm above the widest section: the cavity narrows towards the valves.
LV_INNER = Ellipsoid((0, 0, -18), (24.5, 24.5, 68))
LV_OUTER = Ellipsoid((0, 0, -18), (34.2, 34.2, 74.5))
RV_INNER = Ellipsoid((30, 0, -16), (35.5, 37.5, 58), tilt=np.radians(13))
RV_OUTER = RV_INNER.grown(3.8)

LV_EDGE, RV_EDGE = 3.2, 2.8  # target edge lengths, mm

AZIMUTH = np.radians(48)  # of the long axis: from straight ahead towards the patient's left
ELEVATION = np.radians(38)  # of the long axis: below the horizontal plane
HEART_CENTRE = np.array([33.0, -37.0, -5.0])  # centroid of the myocardium in the torso frame
SKIN = (160.0, 110.0)  # half-widths of the hull, left-right and front-back

ENDO_ANGLE, EPI_ANGLE = np.radians(60), np.radians(-60)

# Seeds on the septum: depth below the base plane, and angle from the middle of the septum towards
# its anterior-superior edge. The bundles surface in the upper septum, under the aortic valve.
ROOT_DEPTH, ROOT_ANGLE = 10.0, np.radians(15)
DIRECTION_DEPTH, DIRECTION_ANGLE = 30.0, np.radians(10)

LV, RV = 0, 1  # region labels


@dataclass(frozen=True)
class Surface:
    """Open triangulated surface, wound counter-clockwise as seen from inside the cavity."""

    points: Floats  # (n, 3), mm
    triangles: Ints  # (m, 3)
    mesh_vertex: Ints  # (n,) index of each point among the vertices of the volume mesh


@dataclass(frozen=True)
class HeartParts:
    """Everything the heart is made of."""

    vertices: Floats  # (n, 3), mm
    tetrahedra: Ints  # (m, 4), positively oriented
    region: Ints  # (m,) LV (with the septum) or RV
    fibre: Floats  # (m, 3), unit vectors
    lv_endocardium: Surface
    rv_endocardium: Surface
    electrodes: dict[str, Floats]
    seeds: dict[str, int]


def mesh_solid() -> tuple[Floats, Ints, Ints]:
    """Mesh the ventricles in the heart frame; vertices, tetrahedra and region of each."""
    gmsh.initialize()
    try:
        for option, value in (
            ("General.Terminal", 0),
            ("General.NumThreads", 1),
            ("Mesh.Algorithm", 6),  # frontal Delaunay
            ("Mesh.Algorithm3D", 1),  # Delaunay
            ("Mesh.MeshSizeMax", LV_EDGE),
        ):
            gmsh.option.setNumber(option, value)
        lv, rv = build_solid()
        gmsh.model.mesh.setSize(gmsh.model.getBoundary(rv, recursive=True), RV_EDGE)
        gmsh.model.mesh.generate(3)
        for _ in range(2):
            gmsh.model.mesh.optimize("")
            gmsh.model.mesh.optimize("Netgen")
        return collect_mesh(lv, rv)
    finally:
        gmsh.finalize()


def build_solid() -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Build the LV shell and the RV wall with a shared interface; their Gmsh volumes."""
    occ = gmsh.model.occ
    below_base = (3, occ.addBox(-200, -200, -200, 400, 400, 200))
    lv, _ = occ.cut([LV_OUTER.add()], [LV_INNER.add()])
    rv, _ = occ.cut([RV_OUTER.add()], [RV_INNER.add(), LV_OUTER.add()])
    lv, _ = occ.intersect(lv, [below_base], removeTool=False)
    rv, _ = occ.intersect(rv, [below_base])
    _, children = occ.fragment(lv, rv)
    occ.synchronize()
    lv, rv = children
    return lv, rv


def collect_mesh(lv: list[tuple[int, int]], rv: list[tuple[int, int]]) -> tuple[Floats, Ints, Ints]:
    """Read the mesh out of Gmsh, without unused nodes and positively oriented."""
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    tetrahedra, region = [], []
    for label, volumes in ((LV, lv), (RV, rv)):
        for _, volume in volumes:
            _, nodes = gmsh.model.mesh.getElementsByType(4, volume)  # 4: linear tetrahedron
            tetrahedra.append(nodes.reshape(-1, 4))
            region.append(np.full(len(tetrahedra[-1]), label))
    position = np.zeros(int(tags.max()) + 1, dtype=np.int64)
    position[tags.astype(np.int64)] = np.arange(len(tags))
    cells = position[np.concatenate(tetrahedra).astype(np.int64)]
    used, cells = np.unique(cells, return_inverse=True)
    cells = cells.reshape(-1, 4)
    vertices = coordinates.reshape(-1, 3)[used]
    inverted = volumes_of(vertices, cells) < 0
    cells[inverted] = cells[inverted][:, [0, 1, 3, 2]]
    return vertices, cells, np.concatenate(region)


def volumes_of(vertices: Floats, tetrahedra: Ints) -> Floats:
    """Signed volumes in mm³."""
    x = vertices[tetrahedra]
    return np.linalg.det(x[:, 1:] - x[:, :1]) / 6


def boundary_facets(tetrahedra: Ints) -> Ints:
    """Triangles that belong to one tetrahedron only, wound outwards."""
    faces = tetrahedra[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    return faces[np.sort(first[count == 1])]


def on(surface: Ellipsoid, corners: Floats) -> NDArray[np.bool_]:
    """Tell which triangles (m, 3, 3) have all corners on an ellipsoid."""
    return np.all(np.abs(surface.level(corners) - 1) < 1e-4, axis=1)


def on_base(corners: Floats) -> NDArray[np.bool_]:
    """Tell which triangles (m, 3, 3) lie in the base plane."""
    return np.all(np.abs(corners[..., 2]) < 1e-6, axis=1)


def on_rv_endocardium(corners: Floats) -> NDArray[np.bool_]:
    """Tell which triangles (m, 3, 3) line the RV cavity: its free wall, or the septum."""
    septal = on(LV_OUTER, corners) & (RV_INNER.level(corners.mean(axis=1)) < 1)
    return (on(RV_INNER, corners) | septal) & ~on_base(corners)


def extract(vertices: Floats, facets: Ints) -> Surface:
    """Cut some outward facets of the myocardium out as a surface of their own."""
    used, triangles = np.unique(facets, return_inverse=True)
    return Surface(vertices[used], triangles.reshape(-1, 3), used)


def endocardia(vertices: Floats, tetrahedra: Ints) -> tuple[Surface, Surface]:
    """Extract the LV and RV endocardium, both open at the base."""
    facets = boundary_facets(tetrahedra)
    corners = vertices[facets]
    lv = extract(vertices, facets[on(LV_INNER, corners) & ~on_base(corners)])
    rv = extract(vertices, facets[on_rv_endocardium(corners)])
    return lv, rv


def solve_laplace(mesh: skfem.MeshTet, fixed: list[tuple[Ints, float]]) -> tuple[Floats, Floats]:
    """Solve Laplace's equation with quadratic elements; value and gradient at cell centres.

    ``fixed`` holds pairs of boundary facets and value; a later pair overrules an earlier one.
    """
    basis = skfem.Basis(mesh, skfem.ElementTetP2(), intorder=2)
    values = basis.zeros()
    dofs = [basis.get_dofs(facets).flatten() for facets, _ in fixed]
    for nodes, (_, value) in zip(dofs, fixed, strict=True):
        values[nodes] = value
    system = skfem.condense(stiffness.assemble(basis), x=values, D=np.unique(np.concatenate(dofs)))
    solution = skfem.solve(*system, solver=skfem.solver_iter_pcg(rtol=1e-10))
    centre = (np.full((3, 1), 0.25), np.array([1 / 6]))
    field = skfem.Basis(mesh, skfem.ElementTetP2(), quadrature=centre).interpolate(solution)
    return np.asarray(field)[:, 0], field.grad[:, :, 0].T


def submesh(vertices: Floats, tetrahedra: Ints) -> tuple[skfem.MeshTet, Ints, Floats]:
    """Make a mesh of some tetrahedra, in the given order; mesh, boundary facets, their corners."""
    used, cells = np.unique(tetrahedra, return_inverse=True)
    mesh = skfem.MeshTet(vertices[used].T.copy(), cells.reshape(-1, 4).T.copy())
    facets = mesh.boundary_facets()
    return mesh, facets, mesh.p[:, mesh.facets[:, facets]].transpose(2, 1, 0)


def transmural(vertices: Floats, tetrahedra: Ints, region: Ints) -> tuple[Floats, Floats]:
    """Depth in the wall (0 endocardium, 1 epicardium) and outward direction, per tetrahedron.

    For the LV the RV side of the septum and the interface with the RV wall count as epicardium. In
    the RV wall the direction ignores the interface, but the depth tends to 1 there, so that the
    fibre angle is that of the adjoining LV and does not jump.
    """
    depth, outward = np.empty(len(tetrahedra)), np.empty((len(tetrahedra), 3))
    mesh, facets, corners = submesh(vertices, tetrahedra[region == LV])
    inner, base = on(LV_INNER, corners), on_base(corners)
    outer = facets[~inner & ~base]
    depth[region == LV], outward[region == LV] = solve_laplace(
        mesh, [(outer, 1.0), (facets[inner], 0.0)]
    )
    mesh, facets, corners = submesh(vertices, tetrahedra[region == RV])
    base, interface = on_base(corners), on(LV_OUTER, corners)
    wall = [(facets[on(RV_OUTER, corners) & ~base], 1.0), (facets[on(RV_INNER, corners)], 0.0)]
    _, outward[region == RV] = solve_laplace(mesh, wall)
    depth[region == RV], _ = solve_laplace(mesh, [*wall, (facets[interface & ~base], 1.0)])
    return np.clip(depth, 0, 1), outward


def baseward(vertices: Floats, tetrahedra: Ints) -> Floats:
    """Gradient of the apex-to-base coordinate, per tetrahedron.

    The coordinate is 1 on the base plane and 0 on the endocardial and epicardial LV apex.
    """
    mesh, facets, corners = submesh(vertices, tetrahedra)
    middle = corners.mean(axis=1)
    apex_radius = 5.0
    at_apex = (np.hypot(middle[:, 0], middle[:, 1]) < apex_radius) & (
        middle[:, 2] < LV_INNER.centre[2]
    )
    _, gradient = solve_laplace(mesh, [(facets[on_base(corners)], 1.0), (facets[at_apex], 0.0)])
    return gradient


def unit(vectors: Floats) -> Floats:
    """Scale vectors (..., 3) to unit length."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def rule_based_fibres(vertices: Floats, tetrahedra: Ints, region: Ints) -> Floats:
    """Fibre direction at the centre of each tetrahedron.

    f = cos α e_c + sin α e_l, with e_t outwards, e_l towards the base and orthogonal to e_t, and
    e_c = e_l × e_t. The angle α falls linearly with depth from +60° (a right-handed helix about the
    apex-to-base axis) at the endocardium to -60° (left-handed) at the epicardium.
    """
    depth, outward = transmural(vertices, tetrahedra, region)
    e_t = unit(outward)
    gradient = baseward(vertices, tetrahedra)
    e_l = unit(gradient - np.sum(gradient * e_t, axis=1, keepdims=True) * e_t)
    e_c = np.cross(e_l, e_t)
    angle = (ENDO_ANGLE + (EPI_ANGLE - ENDO_ANGLE) * depth)[:, None]
    fibre = np.cos(angle) * e_c + np.sin(angle) * e_l
    return smooth_at_junction(fibre, vertices, tetrahedra, region)


def smooth_at_junction(
    fibre: Floats, vertices: Floats, tetrahedra: Ints, region: Ints, sweeps: int = 10
) -> Floats:
    """Even out the fibres where the RV wall meets the LV, and nowhere else.

    Averages the orientation tensors f⊗f, for which a fibre's sign does not matter, over the
    tetrahedra around each vertex, with a weight that falls off away from the interface.
    """
    reach = 3.0  # mm
    shared = np.intersect1d(tetrahedra[region == LV], tetrahedra[region == RV])
    distance, _ = cKDTree(vertices[shared]).query(vertices[tetrahedra].mean(axis=1))
    weight = np.exp(-((distance / reach) ** 2))[:, None, None]
    degree = np.bincount(tetrahedra.ravel(), minlength=len(vertices))[:, None, None]
    tensor = fibre[:, :, None] * fibre[:, None, :]
    for _ in range(sweeps):
        at_vertices = np.zeros((len(vertices), 3, 3))
        for corner in tetrahedra.T:
            np.add.at(at_vertices, corner, tensor)
        at_vertices /= degree
        tensor = (1 - weight) * tensor + weight * at_vertices[tetrahedra].mean(axis=1)
    principal = np.linalg.eigh(tensor)[1][:, :, 2]
    sign = np.where(np.sum(principal * fibre, axis=1, keepdims=True) < 0, -1.0, 1.0)
    return sign * principal


def heart_to_torso() -> Floats:
    """Rotation whose columns are the heart frame's axes in the torso frame."""
    ce, se, ca, sa = np.cos(ELEVATION), np.sin(ELEVATION), np.cos(AZIMUTH), np.sin(AZIMUTH)
    apex_to_base = np.array([-ce * sa, ce * ca, se])
    lv_to_rv = np.array([-ca, -sa, 0.0])  # to the right and to the front, horizontal
    return np.stack([lv_to_rv, np.cross(apex_to_base, lv_to_rv), apex_to_base], axis=1)


def to_torso(points: Floats, centroid: Floats) -> Floats:
    """Move points from the heart frame, where the myocardium has this centroid, to the torso."""
    return (points - centroid) @ heart_to_torso().T + HEART_CENTRE


def skin_point(azimuth_degrees: float, z: float) -> Floats:
    """Point of the hull; azimuth 0 is the front midline, 90 the patient's left side."""
    azimuth = np.radians(azimuth_degrees)
    return np.array([SKIN[0] * np.sin(azimuth), -SKIN[1] * np.cos(azimuth), z])


def nine_electrodes() -> dict[str, Floats]:
    """Place the electrodes on the hull; z = 0 is the fourth intercostal space at the sternum."""
    sternal = float(np.degrees(np.arcsin(25 / SKIN[0])))  # sternal border, 25 mm off the midline
    electrodes = {
        "RA": skin_point(-65, 150),  # right shoulder, below the clavicle
        "LA": skin_point(65, 150),  # left shoulder, below the clavicle
        "LL": skin_point(40, -300),  # left hip, above the iliac crest's front
        "V1": skin_point(-sternal, 0),  # fourth intercostal space, right sternal border
        "V2": skin_point(sternal, 0),  # fourth intercostal space, left sternal border
        "V4": skin_point(34, -38),  # fifth intercostal space, left midclavicular line (x = 89)
        "V5": skin_point(58, -38),  # left anterior axillary line, level of V4
        "V6": skin_point(90, -38),  # left mid-axillary line, level of V4
    }
    electrodes["V3"] = skin_point((sternal + 34) / 2, -19)  # midway between V2 and V4
    return {name: electrodes[name] for name in ("RA", "LA", "LL", *(f"V{i}" for i in range(1, 7)))}


def septal_vertex(surface: Surface, wall: Ellipsoid, depth: float, angle: float) -> int:
    """Surface vertex next to a point of the septum (heart frame; an ellipsoid of revolution)."""
    radius, _, height = wall.semi_axes
    z = -depth - wall.centre[2]
    r = radius * np.sqrt(1 - (z / height) ** 2)
    target = np.array([r * np.cos(angle), r * np.sin(angle), -depth])
    return int(np.argmin(np.linalg.norm(surface.points - target, axis=1)))


def septal_seeds(lv: Surface, rv: Surface) -> dict[str, int]:
    """Root and direction of both bundles as vertex indices of the endocardial surfaces."""
    return {
        f"{name}_{kind}": septal_vertex(surface, wall, depth, angle)
        for name, surface, wall in (("lv", lv, LV_INNER), ("rv", rv, LV_OUTER))
        for kind, depth, angle in (
            ("root", ROOT_DEPTH, ROOT_ANGLE),
            ("direction", DIRECTION_DEPTH, DIRECTION_ANGLE),
        )
    }


def make_heart() -> HeartParts:
    """Make the default heart, placed in the torso."""
    vertices, tetrahedra, region = mesh_solid()
    fibre = rule_based_fibres(vertices, tetrahedra, region)
    lv, rv = endocardia(vertices, tetrahedra)
    seeds = septal_seeds(lv, rv)
    centroid = np.average(
        vertices[tetrahedra].mean(axis=1), axis=0, weights=volumes_of(vertices, tetrahedra)
    )
    placed = to_torso(vertices, centroid)
    return HeartParts(
        vertices=placed,
        tetrahedra=tetrahedra,
        region=region,
        fibre=fibre @ heart_to_torso().T,
        lv_endocardium=Surface(placed[lv.mesh_vertex], lv.triangles, lv.mesh_vertex),
        rv_endocardium=Surface(placed[rv.mesh_vertex], rv.triangles, rv.mesh_vertex),
        electrodes=nine_electrodes(),
        seeds=seeds,
    )


def as_heart(parts: HeartParts) -> Heart:
    """The parts as the package holds them."""
    endocardia = {
        side: Endocardium(
            side,
            surface.points,
            surface.triangles,
            parts.seeds[f"{side}_root"],
            parts.seeds[f"{side}_direction"],
        )
        for side, surface in (("lv", parts.lv_endocardium), ("rv", parts.rv_endocardium))
    }
    return Heart(
        parts.vertices,
        parts.tetrahedra,
        parts.fibre,
        endocardia["lv"],
        endocardia["rv"],
        np.array([np.round(parts.electrodes[name], 2) for name in ELECTRODES]),
        "idealised adult heart",
    )


def smallest_dihedral_angles(vertices: Floats, tetrahedra: Ints) -> Floats:
    """Smallest angle between two faces of each tetrahedron, in degrees."""
    x = vertices[tetrahedra[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]]]
    normals = unit(np.cross(x[:, :, 1] - x[:, :, 0], x[:, :, 2] - x[:, :, 0]))
    cosines = -normals @ normals.transpose(0, 2, 1)
    first, second = np.triu_indices(4, k=1)
    return np.degrees(np.arccos(np.clip(cosines[:, first, second].max(axis=1), -1, 1)))


def cavity_volume(surface: Surface) -> float:
    """Volume in ml; seen from a point of the base plane, the flat lid has no share in it."""
    height = surface.points @ heart_to_torso()[:, 2]
    x = surface.points[surface.triangles] - surface.points[np.argmax(height)]
    return float(-np.linalg.det(x).sum() / 6 / 1000)


def summary(heart: HeartParts) -> str:
    """One line each for the volumes and for the mesh."""
    volume = volumes_of(heart.vertices, heart.tetrahedra)
    wall = [volume[heart.region == label].sum() / 1000 for label in (LV, RV)]
    cavity = [cavity_volume(surface) for surface in (heart.lv_endocardium, heart.rv_endocardium)]
    angle = smallest_dihedral_angles(heart.vertices, heart.tetrahedra)
    return (
        f"myocardium LV {wall[0]:.1f} ml, RV {wall[1]:.1f} ml; "
        f"cavities LV {cavity[0]:.1f} ml, RV {cavity[1]:.1f} ml\n"
        f"{len(heart.vertices)} vertices, {len(heart.tetrahedra)} tetrahedra; smallest volume "
        f"{volume.min():.2f} mm³, smallest dihedral angle {angle.min():.1f} degrees, "
        f"{np.mean(angle < 20):.2%} of the tetrahedra below 20"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the packaged default heart.")
    parser.add_argument("folder", type=Path, help="where the files go")
    folder = parser.parse_args().folder
    heart = make_heart()
    write_heart(as_heart(heart), folder)
    print(summary(heart))


if __name__ == "__main__":
    main()
