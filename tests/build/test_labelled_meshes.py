"""Tetrahedra with labels of their surface, from every format; what is wrong is said in one line."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
import pyvista as pv
from builders import box
from scipy.spatial import cKDTree
from shapes import read_labelled_mesh

from fascicle.core.errors import InputError
from fascicle.heart.label_names import EXAMPLE, label_of, labels_by_number
from fascicle.heart.labelled_surface import Label
from fascicle.mesh.formats.read import read_mesh
from fascicle.mesh.measures import triangle_normals
from fascicle.mesh.topology import boundary_triangles

SIZE = 60.0  # mm
NAMES = {
    Label.BASE: "base",
    Label.EPICARDIUM: "epi",
    Label.LV_ENDOCARDIUM: "lv_endo",
    Label.RV_ENDOCARDIUM: "rv_endo",
}


class Block:
    """A block whose left face is the LV, its right the RV, its top the base."""

    def __init__(self):
        heart = box(SIZE, 4, jitter=0.1)
        self.points, self.tetrahedra = heart.vertices, heart.tetrahedra
        self.triangles, _ = boundary_triangles(self.tetrahedra)
        x, _, z = self.points[self.triangles].mean(axis=1).T
        self.labels = np.full(len(self.triangles), int(Label.EPICARDIUM))
        self.labels[z > SIZE - 1e-6] = Label.BASE
        self.labels[x < 1e-6] = Label.LV_ENDOCARDIUM
        self.labels[x > SIZE - 1e-6] = Label.RV_ENDOCARDIUM
        rng = np.random.default_rng(2)
        self.axes = np.linalg.qr(rng.standard_normal((len(self.tetrahedra), 3, 3)))[0]
        self.regions = rng.integers(0, 3, len(self.tetrahedra))

    def vtu(self, path, labels=None, triangles=None, tetrahedra=None, name="label", **points):
        triangles = self.triangles if triangles is None else triangles
        labels = self.labels if labels is None else labels
        tetrahedra = self.tetrahedra if tetrahedra is None else tetrahedra
        blocks = {pv.CellType.TRIANGLE: triangles, pv.CellType.TETRA: tetrahedra}
        grid = pv.UnstructuredGrid(blocks, self.points)
        zero = np.zeros((len(triangles), 3))
        grid.cell_data[name] = np.concatenate([labels, np.zeros(len(tetrahedra), int)])
        if len(tetrahedra) == len(self.tetrahedra):
            grid.cell_data["fibre"] = np.concatenate([zero, 2 * self.axes[:, :, 0]])
            grid.cell_data["sheet"] = np.concatenate([zero, self.axes[:, :, 1]])
            grid.cell_data["region"] = np.concatenate([zero[:, 0], self.regions])
        grid.point_data.update(points)
        grid.save(path)
        return path

    def msh(self, path, names=NAMES, version="gmsh22", binary=True):
        groups = {name: np.array([10 + label, 2]) for label, name in names.items()}
        cells, numbers = [("tetra", self.tetrahedra)], [np.ones(len(self.tetrahedra), int)]
        for label in Label:
            if (self.labels == label).any():
                cells.append(("triangle", self.triangles[self.labels == label]))
                numbers.append(np.full(len(cells[-1][1]), 10 + label if names else int(label)))
        data = {"gmsh:physical": numbers, "gmsh:geometrical": numbers}
        mesh = meshio.Mesh(self.points, cells, cell_data=data, field_data=groups)
        if version == "gmsh":  # meshio writes groups of format 4 only with entities of points
            entity = np.tile([3, 1], (len(self.points), 1))
            for _, block in cells[1:]:
                entity[np.unique(block)] = [2, 0]
            for (_, block), number in zip(cells[1:], numbers[1:], strict=True):
                entity[np.unique(block)] = [2, number[0]]
            mesh.point_data["gmsh:dim_tags"] = entity
        meshio.write(path, mesh, file_format=version, binary=binary)
        return path

    def carp(self, folder, names=NAMES, suffix=".surf", factor=1000.0):
        def write(name, header, rows):
            (folder / name).write_text("\n".join([*header, *rows]) + "\n")

        def text(rows, lead=""):
            return [lead + " ".join(map(str, row)) for row in rows.tolist()]

        tagged = np.column_stack([self.tetrahedra, self.regions])
        write("block.pts", [str(len(self.points))], text(self.points * factor))
        write("block.elem", [str(len(tagged))], text(tagged, "Tt "))
        write("block.lon", ["2"], text(np.hstack([self.axes[:, :, 0], self.axes[:, :, 1]])))
        for label, name in names.items():
            rows = self.triangles[self.labels == label]
            if suffix == ".surf":
                write(name + suffix, [str(len(rows))], text(rows, "Tr "))
            else:
                used = np.unique(rows)
                write(name + suffix, [str(len(used)), "extra"], text(used[:, None]))
        return folder / "block.pts"


@pytest.fixture
def block():
    return Block()


def check(read, block, labels=None):
    """The mesh, its labels, regions, fibres and sheets are the block's."""
    assert np.abs(read.mesh.vertices - block.points).max() < 1e-9
    np.testing.assert_array_equal(read.mesh.tetrahedra, block.tetrahedra)
    np.testing.assert_array_equal(read.mesh.triangles, block.triangles)
    np.testing.assert_array_equal(read.mesh.labels, block.labels if labels is None else labels)
    assert len(read.mesh.having(Label.BASE)) == (read.mesh.labels == Label.BASE).sum()


def check_directions(read, block):
    np.testing.assert_array_equal(read.mesh.regions, block.regions)
    assert np.abs(read.fibres - block.axes[:, :, 0]).max() < 1e-14
    assert np.abs(read.sheets - block.axes[:, :, 1]).max() < 1e-14


@pytest.mark.parametrize("name", ["a.vtu", "a.vtk"])
def test_triangles_beside_the_tetrahedra(tmp_path, block, name):
    read = read_labelled_mesh(block.vtu(tmp_path / name))
    check(read, block)
    check_directions(read, block)


def test_an_array_of_another_name(tmp_path, block):
    path = block.vtu(tmp_path / "a.vtu", name="patch")
    assert not read_labelled_mesh(path).mesh.labels.any()
    check(read_labelled_mesh(path, array="patch"), block)
    with pytest.raises(InputError, match="no array 'patches' on triangles or points; there are: "):
        read_labelled_mesh(path, array="patches")


def test_numbers_of_another_meaning(tmp_path, block):
    path = block.vtu(tmp_path / "a.vtu", labels=block.labels + 40)
    with pytest.raises(
        InputError, match=r"unknown labels: 41 \(32 times\), .*; known are 1 base, 2 epi"
    ):
        read_labelled_mesh(path)
    names = {str(40 + label): label for label in NAMES}
    check(read_labelled_mesh(path, names=names), block)
    assert EXAMPLE == "--labels base=1,epicardium=2,lv=3,rv=4"
    own = {"base": 41, "epi": 42, "LV endo": 43, "rv_endo": 44}
    assert labels_by_number(own) == names


def test_a_named_label_gives_up_its_own_number(tmp_path, block):
    exchanged = np.array([0, 1, 2, 4, 3])[block.labels]
    path = block.vtu(tmp_path / "a.vtu", labels=exchanged)
    check(read_labelled_mesh(path, names=labels_by_number({"lv": 4, "rv": 3})), block)
    path = block.vtu(tmp_path / "b.vtu", labels=np.where(exchanged == 4, 9, exchanged))
    with pytest.raises(
        InputError, match=r"unknown labels: 3 \(.*known are 9 lv_endocardium, 1 base"
    ):
        read_labelled_mesh(path, names=labels_by_number({"lv": 9}))


def test_triangles_face_outwards(tmp_path, block):
    read = read_labelled_mesh(block.vtu(tmp_path / "a.vtu"))
    normals = triangle_normals(read.mesh.vertices, read.mesh.triangles)
    outwards = read.mesh.vertices[read.mesh.triangles].mean(axis=1) - SIZE / 2
    assert (np.einsum("ij,ij->i", normals, outwards) > 0).all()


def point_classes(block):
    """A class for every boundary point; the top edge of a side belongs to the side."""
    classes = np.full(len(block.points), np.nan)  # inner points have none
    for label in (Label.BASE, Label.EPICARDIUM, Label.RV_ENDOCARDIUM, Label.LV_ENDOCARDIUM):
        classes[block.triangles[block.labels == label]] = label
    return classes


def test_classes_of_points(tmp_path, block):
    classes = point_classes(block)
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: block.tetrahedra}, block.points)
    grid.point_data["class"] = classes
    grid.save(tmp_path / "a.vtu")
    read = read_labelled_mesh(tmp_path / "a.vtu")
    corners = classes[block.triangles]
    most = [np.bincount(row.astype(int), minlength=5).max() for row in corners]
    chosen = (corners == read.mesh.labels[:, None]).sum(axis=1)
    np.testing.assert_array_equal(chosen, most)
    same = (corners == corners[:, :1]).all(axis=1)
    assert same.sum() > 100
    np.testing.assert_array_equal(read.mesh.labels[same], corners[same, 0])
    assert read.fibres is None
    assert read.mesh.regions is None


def test_a_point_without_a_class(tmp_path, block):
    classes = np.nan_to_num(point_classes(block))
    classes[block.triangles[0, 0]] = 0
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: block.tetrahedra}, block.points)
    grid.point_data["class"] = classes
    grid.save(tmp_path / "a.vtu")
    with pytest.raises(InputError, match=r"array 'class': unknown labels: 0 \(1 times\)"):
        read_labelled_mesh(tmp_path / "a.vtu")


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize(
    "names",
    [
        NAMES,
        dict(zip(NAMES, ("Base", "EPI", "LVendo", "endo_rv"), strict=True)),
        dict(zip(NAMES, ("basal plane", "epicardium", "LV", "Right Ventricle"), strict=True)),
        {},
    ],
)
def test_physical_groups(tmp_path, block, names, binary):
    read = read_labelled_mesh(block.msh(tmp_path / "a.msh", names, binary=binary))
    check(read, block)
    np.testing.assert_array_equal(read.mesh.regions, 1)


def test_physical_groups_of_format_4(tmp_path, block):
    read = read_labelled_mesh(block.msh(tmp_path / "a.msh", version="gmsh"))
    centres = read.mesh.vertices[read.mesh.triangles].mean(
        axis=1
    )  # meshio orders points by their entity
    distance, same = cKDTree(block.points[block.triangles].mean(axis=1)).query(centres)
    assert distance.max() < 1e-9
    np.testing.assert_array_equal(read.mesh.labels, block.labels[same])


def test_groups_of_other_names(tmp_path, block):
    names = {**NAMES, Label.EPICARDIUM: "pericardial"}
    path = block.msh(tmp_path / "a.msh", names)
    with pytest.raises(InputError, match="cannot tell which surface 'pericardial' is"):
        read_labelled_mesh(path)
    check(read_labelled_mesh(path, names={"pericardial": Label.EPICARDIUM}), block)
    with pytest.raises(InputError, match=r"--labels epicardium=12$") as caught:
        read_labelled_mesh(path)
    word = str(caught.value).split()[-1].split("=")
    check(read_labelled_mesh(path, names=labels_by_number({word[0]: int(word[1])})), block)


def test_gmsh_data_of_some_elements(tmp_path, block):
    """Fibres of the tetrahedra alone, as Gmsh writes them, beside triangles, numbers with gaps."""
    path = block.msh(tmp_path / "a.msh", binary=False)
    first = 1  # meshio numbers the tetrahedra first
    rows = [
        f"{first + k} " + " ".join(map(repr, axis))
        for k, axis in enumerate(block.axes[:, :, 0].tolist())
    ]
    head = ["$ElementData", "1", '"fibre"', "1", "0.0", "3", "0", "3", str(len(rows))]
    with path.open("a") as file:
        file.write("\n".join([*head, *reversed(rows), "$EndElementData"]) + "\n")
    read = read_labelled_mesh(path)
    check(read, block)
    assert np.abs(read.fibres - block.axes[:, :, 0]).max() < 1e-14


@pytest.mark.parametrize(
    "names",
    [
        {label: f"block_{name}" for label, name in NAMES.items()},
        dict(zip(NAMES, ("block.base", "block.epi", "block.lvendo", "rv_endo"), strict=True)),
    ],
)
def test_surf_files_beside_opencarp(tmp_path, block, names):
    read = read_labelled_mesh(block.carp(tmp_path, names))
    check(read, block)
    check_directions(read, block)


def test_vtx_files_beside_opencarp(tmp_path, block):
    path = block.carp(tmp_path, {k: f"block.{name}.surf" for k, name in NAMES.items()}, ".vtx")
    (tmp_path / "lv_endo_stimulus.vtx").write_text("1\nextra\n3\n")
    read = read_labelled_mesh(path)
    differ = read.mesh.labels != block.labels
    assert not differ[np.isin(block.labels, [Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM])].any()
    assert differ.sum() <= 4  # triangles in a corner have all their points on two surfaces


def test_a_mesh_in_mm_by_its_extent(tmp_path, block):
    check(read_labelled_mesh(block.carp(tmp_path, factor=1.0)), block)
    with pytest.raises(InputError, match="it seems to be in centimetres"):
        read_labelled_mesh(block.carp(tmp_path, factor=100.0))


def test_without_labels_the_boundary_is_there(tmp_path, block):
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: block.tetrahedra}, block.points)
    grid.save(tmp_path / "a.vtu")
    read = read_labelled_mesh(tmp_path / "a.vtu")
    assert not read.mesh.labels.any()
    np.testing.assert_array_equal(read.mesh.triangles, block.triangles)


def test_points_of_no_tetrahedron_are_left_out(tmp_path, block):
    spare = np.full((3, 3), 7.0)
    plain = Block()
    plain.points = np.vstack([spare, block.points])
    plain.tetrahedra, plain.triangles = block.tetrahedra + 3, block.triangles + 3
    check(read_labelled_mesh(plain.vtu(tmp_path / "a.vtu")), block)


def test_tetrahedra_all_inverted_are_turned(tmp_path, block):
    path = block.vtu(tmp_path / "a.vtu", tetrahedra=block.tetrahedra[:, [1, 0, 2, 3]])
    read = read_labelled_mesh(path)
    assert len(read.notes) == 1
    assert "all were inverted and have been turned" in read.notes[0]
    assert read_labelled_mesh(block.vtu(tmp_path / "b.vtu")).notes == ()
    np.testing.assert_array_equal(np.sort(read.mesh.tetrahedra), np.sort(block.tetrahedra))
    order = np.lexsort(np.sort(read.mesh.triangles).T), np.lexsort(np.sort(block.triangles).T)
    np.testing.assert_array_equal(read.mesh.labels[order[0]], block.labels[order[1]])


def test_some_inverted_tetrahedra_are_refused(tmp_path, block):
    block.tetrahedra[7] = block.tetrahedra[7][[1, 0, 2, 3]]
    with pytest.raises(InputError, match=r"1 of 384 tetrahedra are inverted \(first: 7\)"):
        read_labelled_mesh(block.vtu(tmp_path / "a.vtu"))


def test_tissue_in_pieces_is_refused(tmp_path, block):
    middle = block.points[block.tetrahedra][:, :, 0].mean(axis=1)
    left, right = middle < 14, middle > 46
    path = block.vtu(tmp_path / "a.vtu", tetrahedra=block.tetrahedra[left | right])
    with pytest.raises(InputError, match="falls into 2 unconnected pieces"):
        read_labelled_mesh(path)


def test_missing_labels_are_named(tmp_path, block):
    rest = ~np.isin(block.labels, [Label.BASE, Label.RV_ENDOCARDIUM])
    path = block.vtu(tmp_path / "a.vtu", block.labels[rest], block.triangles[rest])
    with pytest.raises(
        InputError, match=r"missing: base, rv endocardium \(64 of 192 boundary triangles have no"
    ):
        read_labelled_mesh(path)


def test_valves_are_a_base_too(tmp_path, block):
    block.labels[block.labels == Label.BASE] = Label.MITRAL
    check(read_labelled_mesh(block.vtu(tmp_path / "a.vtu")), block)


def test_a_triangle_without_a_label(tmp_path, block):
    path = block.vtu(tmp_path / "a.vtu", block.labels[1:], block.triangles[1:])
    with pytest.raises(InputError, match=r"1 of 192 boundary triangles have no label \(first: 0\)"):
        read_labelled_mesh(path)


def test_triangles_off_the_boundary(tmp_path, block):
    inner = np.array([[0, 31, 62], [0, 1, 62]])
    path = block.vtu(
        tmp_path / "a.vtu", np.append(block.labels, [2, 2]), np.vstack([block.triangles, inner])
    )
    with pytest.raises(InputError, match="2 of 194 labelled triangles are not on the boundary"):
        read_labelled_mesh(path)


def test_a_triangle_with_two_labels(tmp_path, block):
    label = Label.EPICARDIUM if block.labels[5] != Label.EPICARDIUM else Label.BASE
    path = block.vtu(
        tmp_path / "a.vtu",
        np.append(block.labels, label),
        np.vstack([block.triangles, block.triangles[5:6, ::-1]]),
    )
    with pytest.raises(InputError, match=r"1 of \d+ triangles have two labels"):
        read_labelled_mesh(path)


def test_regions_must_be_whole(tmp_path, block):
    block.regions = block.regions + 0.5
    with pytest.raises(InputError, match="'region' must hold one whole number"):
        read_labelled_mesh(block.vtu(tmp_path / "a.vtu"))


def test_elements_of_a_bath_are_refused(tmp_path, block):
    block.axes[3] = 0
    with pytest.raises(InputError, match=r"'fibre': 1 of 384 fibres have zero length \(first: 3\)"):
        read_labelled_mesh(block.carp(tmp_path))


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("LV", Label.LV_ENDOCARDIUM),
        ("lv_endo", Label.LV_ENDOCARDIUM),
        ("LVendo", Label.LV_ENDOCARDIUM),
        ("endo-lv.1", Label.LV_ENDOCARDIUM),
        ("Left Ventricle", Label.LV_ENDOCARDIUM),
        ("RVEndocardium", Label.RV_ENDOCARDIUM),
        ("rv_septum", Label.RV_ENDOCARDIUM),
        ("EPI", Label.EPICARDIUM),
        ("lv_epi", Label.EPICARDIUM),
        ("epicardial surface", Label.EPICARDIUM),
        ("base", Label.BASE),
        ("RVbase", Label.BASE),
        ("mitral_valve", Label.MITRAL),
        ("aortic annulus", Label.AORTIC),
        ("TV", Label.TRICUSPID),
        ("pulmonary_valve", Label.PULMONARY),
        ("endo", None),
        ("lv_rv_endo", None),
        ("lv_endo_stimulus", None),
        ("valve", None),
        ("lvx", None),
        ("", None),
        ("base" * 20, None),
    ],
)
def test_spellings(name, label):
    assert label_of(name) == label


def why_refused(path):
    """The message of an InputError; None if the file was read."""
    try:
        read_labelled_mesh(path)
    except InputError as error:
        return str(error)
    return None


def test_cuts_and_flips_are_refused_or_harmless(tmp_path, block):
    """Every truncation of a Gmsh file, and flipped bytes, end in one line or a whole mesh."""
    rng, seen = np.random.default_rng(0), 0
    for binary in (True, False):
        path = block.msh(tmp_path / "a.msh", binary=binary)
        whole = path.read_bytes()
        ends = np.unique(np.linspace(0, len(whole) - 2, 60).astype(int))
        damaged = [whole[:end] for end in ends]
        for _ in range(100):
            flipped = bytearray(whole)
            flipped[rng.integers(len(whole))] ^= 1 << rng.integers(8)
            damaged.append(bytes(flipped))
        for number, content in enumerate(damaged):
            path.write_bytes(content)
            refused = why_refused(path)
            seen += refused is not None
            assert refused is None or "\n" not in refused
            assert refused is not None or number >= len(ends), "a part was taken for the whole"
    assert seen > 180


def test_gmsh_of_format_2_without_tags_or_with_other_cells(tmp_path):
    path = tmp_path / "a.msh"
    path.write_text(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Comments\nby hand\n$EndComments\n"
        "$Nodes\n5\n9 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n7 1 1 0\n$EndNodes\n"
        "$Elements\n4\n1 15 2 0 1 9\n2 4 0 9 2 3 4\n3 2 2 5 1 9 2 3\n8 3 2 5 1 9 2 7 3\n"
        "$EndElements\n"
        '$NodeData\n1\n"t"\n1\n0\n3\n0\n1\n5\n2 .2\n9 .9\n3 .3\n4 .4\n7 .7\n$EndNodeData\n'
    )
    mesh = read_mesh(path)
    np.testing.assert_array_equal(mesh.cells[10], [[0, 1, 2, 3]])
    np.testing.assert_array_equal(mesh.cells[5], [[0, 1, 2]])
    assert mesh.others == {"quadrangle": 1}
    np.testing.assert_array_equal(mesh.point_data["t"], [0.9, 0.2, 0.3, 0.4, 0.7])
    assert mesh.cell_data[10]["gmsh:physical"] == [0]
    assert mesh.cell_data[5]["gmsh:physical"] == [5]
