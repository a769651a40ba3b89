"""Tetrahedra with labels of their surface, from every format; errors in one line."""

import meshio
import numpy as np
import pytest
import pyvista as pv
from builders import block_of_random_tissue
from scipy.spatial import cKDTree
from shapes import read_labelled_mesh

from fascicle.build.export import write_opencarp
from fascicle.build.labelled_files import labelled_tetrahedra
from fascicle.build.mesh_repair import repaired_mesh
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import Label, LabelledMesh, label_of, labels_by_number
from fascicle.mesh.read import read_mesh
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
        self.heart = block_of_random_tissue(SIZE, np.random.default_rng(2))
        self.points, self.tetrahedra = self.heart.vertices, self.heart.tetrahedra
        self.triangles, _ = boundary_triangles(self.tetrahedra)
        x, _, z = self.points[self.triangles].mean(axis=1).T
        self.labels = np.full(len(self.triangles), int(Label.EPICARDIUM))
        self.labels[z > SIZE - 1e-6] = Label.BASE
        self.labels[x < 1e-6] = Label.LV_ENDOCARDIUM
        self.labels[x > SIZE - 1e-6] = Label.RV_ENDOCARDIUM
        self.fibres, self.regions = self.heart.fibres, self.heart.regions

    def vtu(self, path, tetrahedra=None, name="label"):
        tetrahedra = self.tetrahedra if tetrahedra is None else tetrahedra
        blocks = {pv.CellType.TRIANGLE: self.triangles, pv.CellType.TETRA: tetrahedra}
        grid = pv.UnstructuredGrid(blocks, self.points)
        zero = np.zeros((len(self.triangles), 3))
        grid.cell_data[name] = np.concatenate([self.labels, np.zeros(len(tetrahedra), int)])
        grid.cell_data["fibre"] = np.concatenate([zero, 2 * self.fibres])
        grid.cell_data["sheet"] = np.concatenate([zero, self.heart.sheets])
        grid.cell_data["region"] = np.concatenate([zero[:, 0], self.regions])
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

    def carp(self, folder, names=NAMES, suffix=".surf"):
        """Files for openCARP, those of surfaces or of their vertices alone by these names."""
        surface = LabelledMesh(self.points, self.tetrahedra, self.triangles, self.labels)
        write_opencarp(self.heart, surface, folder / "block")
        for label, name in names.items():
            written = (folder / f"block_{NAMES[label]}{suffix}").read_bytes()
            for other in (".surf", ".vtx"):
                (folder / f"block_{NAMES[label]}{other}").unlink()
            (folder / (name + suffix)).write_bytes(written)
        return folder / "block.pts"


@pytest.fixture
def block():
    return Block()


def check(read, block, directions=False):
    """The mesh, its labels, and perhaps regions, fibres and sheets are the block's."""
    assert np.abs(read.mesh.vertices - block.points).max() < 1e-9
    np.testing.assert_array_equal(read.mesh.tetrahedra, block.tetrahedra)
    np.testing.assert_array_equal(read.mesh.triangles, block.triangles)
    np.testing.assert_array_equal(read.mesh.labels, block.labels)
    if directions:
        np.testing.assert_array_equal(read.mesh.regions, block.regions)
        assert np.abs(read.fibres - block.fibres).max() < 1e-14
        assert np.abs(read.sheets - block.heart.sheets).max() < 1e-14


def test_triangles_with_the_tetrahedra_and_an_array_of_another_name(tmp_path, block):
    for name in ("a.vtu", "a.vtk"):
        check(read_labelled_mesh(block.vtu(tmp_path / name)), block, directions=True)
    path = block.vtu(tmp_path / "a.vtu", name="patch")
    assert not read_labelled_mesh(path).mesh.labels.any()
    check(read_labelled_mesh(path, array="patch"), block)
    with pytest.raises(InputError, match="no array 'patches' on triangles or points; there are: "):
        read_labelled_mesh(path, array="patches")


def test_classes_of_points(tmp_path, block):
    """One for every boundary point; the top edge of a side belongs to the side."""
    classes = np.full(len(block.points), np.nan)  # inner points have none
    for label in (Label.BASE, Label.EPICARDIUM, Label.RV_ENDOCARDIUM, Label.LV_ENDOCARDIUM):
        classes[block.triangles[block.labels == label]] = label
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: block.tetrahedra}, block.points)
    grid.save(tmp_path / "a.vtu")
    read = read_labelled_mesh(tmp_path / "a.vtu")
    assert not read.mesh.labels.any()
    np.testing.assert_array_equal(read.mesh.triangles, block.triangles)
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


def test_physical_groups(tmp_path, block):
    spelt = dict(zip(NAMES, ("basal plane", "EPI", "LVendo", "Right Ventricle"), strict=True))
    for names, binary in ((NAMES, True), (spelt, False), ({}, True)):
        read = read_labelled_mesh(block.msh(tmp_path / "a.msh", names, binary=binary))
        check(read, block)
        np.testing.assert_array_equal(read.mesh.regions, 1)
    read = read_labelled_mesh(block.msh(tmp_path / "a.msh", version="gmsh"))  # format 4
    # meshio orders points by their entity
    centres = read.mesh.vertices[read.mesh.triangles].mean(axis=1)
    distance, same = cKDTree(block.points[block.triangles].mean(axis=1)).query(centres)
    assert distance.max() < 1e-9
    np.testing.assert_array_equal(read.mesh.labels, block.labels[same])


def test_groups_of_other_names(tmp_path, block):
    names = {**NAMES, Label.EPICARDIUM: "pericardial"}
    path = block.msh(tmp_path / "a.msh", names)
    words = r"cannot tell which surface 'pericardial' is.* labels= epicardium=12$"
    with pytest.raises(InputError, match=words):
        read_labelled_mesh(path)
    check(read_labelled_mesh(path, names={"pericardial": Label.EPICARDIUM}), block)
    check(read_labelled_mesh(path, names=labels_by_number({"epicardium": 12})), block)


def test_gmsh_data_of_some_elements(tmp_path, block):
    """Fibres of the tetrahedra alone, as Gmsh writes them, with triangles."""
    path = block.msh(tmp_path / "a.msh", binary=False)
    first = 1  # meshio numbers the tetrahedra first
    rows = [
        f"{first + k} " + " ".join(map(repr, axis)) for k, axis in enumerate(block.fibres.tolist())
    ]
    head = ["$ElementData", "1", '"fibre"', "1", "0.0", "3", "0", "3", str(len(rows))]
    with path.open("a") as file:
        file.write("\n".join([*head, *reversed(rows), "$EndElementData"]) + "\n")
    read = read_labelled_mesh(path)
    check(read, block)
    assert np.abs(read.fibres - block.fibres).max() < 1e-14


def test_surf_and_vtx_files_next_to_opencarp(tmp_path, block):
    names = dict(zip(NAMES, ("block.base", "block.epi", "block.lvendo", "rv_endo"), strict=True))
    check(read_labelled_mesh(block.carp(tmp_path, names)), block, directions=True)
    for file in tmp_path.glob("*.surf"):
        file.unlink()
    path = block.carp(tmp_path, {k: f"block.{name}.surf" for k, name in NAMES.items()}, ".vtx")
    (tmp_path / "lv_endo_stimulus.vtx").write_text("1\nextra\n3\n")
    read = read_labelled_mesh(path)
    differ = read.mesh.labels != block.labels
    assert not differ[np.isin(block.labels, [Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM])].any()
    assert differ.sum() <= 4  # triangles in a corner have all their points on two surfaces


def test_tetrahedra_all_inverted_are_turned(tmp_path, block):
    path = block.vtu(tmp_path / "a.vtu", tetrahedra=block.tetrahedra[:, [1, 0, 2, 3]])
    turned, notes = repaired_mesh(read_mesh(path))
    assert len(notes) == 1
    assert "all were inverted and have been turned" in notes[0]
    assert repaired_mesh(read_mesh(block.vtu(tmp_path / "b.vtu")))[1] == ()
    read = labelled_tetrahedra(turned)
    assert read.notes == (
        "fibres: array 'fibre' has vectors of length 2 to 2; they were made unit vectors",
    )
    np.testing.assert_array_equal(np.sort(read.mesh.tetrahedra), np.sort(block.tetrahedra))
    order = np.lexsort(np.sort(read.mesh.triangles).T), np.lexsort(np.sort(block.triangles).T)
    np.testing.assert_array_equal(read.mesh.labels[order[0]], block.labels[order[1]])


def test_wrong_meshes_are_refused(tmp_path):
    def refused(words, **wrong):
        block = Block()
        vars(block).update(wrong)
        with pytest.raises(InputError, match=words):
            read_labelled_mesh(block.vtu(tmp_path / "a.vtu"))

    whole = Block()
    some = whole.labels < 4
    words = r"missing: rv endocardium \(32 of 192 boundary triangles have none\); add them"
    refused(words, triangles=whole.triangles[some], labels=whole.labels[some])
    refused("'region' must hold one whole number", regions=whole.regions + 0.5)
    refused("unknown labels: 41 .*known are 1 base", labels=whole.labels + 40)


def test_spellings():
    spellings = {
        "endo-lv.1": Label.LV_ENDOCARDIUM, "Left Ventricle": Label.LV_ENDOCARDIUM,
        "rv_septum": Label.RV_ENDOCARDIUM, "lv_epi": Label.EPICARDIUM, "RVbase": Label.BASE,
        "aortic annulus": Label.AORTIC, "lv_rv_endo": None, "lv_endo_stimulus": None,
        "base" * 20: None,
    }  # fmt: skip
    assert {name: label_of(name) for name in spellings} == spellings


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
    np.testing.assert_array_equal(mesh.cells[5], [[0, 1, 2], [1, 4, 2], [2, 0, 1]])
    np.testing.assert_array_equal(mesh.point_data["t"], [0.9, 0.2, 0.3, 0.4, 0.7])
    assert mesh.cell_data[10]["gmsh:physical"] == [0]
    assert mesh.cell_data[5]["gmsh:physical"].tolist() == [5, 5, 5]
