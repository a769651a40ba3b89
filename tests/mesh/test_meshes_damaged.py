"""Mesh files of every format; cut short or scrambled: refused in one line, never read in part.

Several of these made VTK print to the terminal, return garbage in place of the missing end, or
crash the process (binary PLY), and meshio leave the program or search for ever.
"""

import meshio
import numpy as np
import pytest
import pyvista as pv
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

from fascicle.core.errors import InputError
from fascicle.mesh.mesh_file import TETRAHEDRON, TRIANGLE
from fascicle.mesh.read import read_mesh

CUTS = [0, 0.001, 0.01, 0.03, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 0.995, -100, -40, -20, -10, -5]
RUBBISH = {
    "random": np.random.default_rng(0).bytes(3000),
    "text": b"hello\nworld\n" * 20,
    "zeros": bytes(3000),
}
WITH_FIBRES = ["b.vtk", "a.vtk", "b.vtu", "a.vtu", "appended.vtu", "raw.vtu", "b.msh"]
TISSUE = [*WITH_FIBRES, "a.msh", "a22.msh"]
SURFACES = ["b.vtp", "a.vtp", "sb.vtk", "b.ply", "a.ply", "b.stl", "a.stl", "a.obj"]

BLOCK = pv.ImageData(dimensions=(5, 5, 5), spacing=(15, 15, 15))
BLOCK = BLOCK.cast_to_unstructured_grid().triangulate()
BLOCK.point_data["fibre"] = np.random.default_rng(1).standard_normal((BLOCK.n_points, 3))
SHEET = pv.Plane(i_resolution=8, j_resolution=8, i_size=40, j_size=40).triangulate()
SHEET.clear_data()


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Whole files in every format, by name."""
    folder = tmp_path_factory.mktemp("whole")
    for name in ("b.vtk", "a.vtk", "b.vtu", "a.vtu"):
        BLOCK.save(folder / name, binary=name[0] == "b")
    for name in ("b.vtp", "a.vtp", "sb.vtk", "b.ply", "a.ply", "b.stl", "a.stl"):
        SHEET.save(folder / name, binary="b" in name[:2])
    pv.save_meshio(folder / "a.obj", SHEET)
    lines = (folder / "a.obj").read_text().replace("\nf ", "\ns off\nf ", 1)
    (folder / "a.obj").write_text(f"mtllib none.mtl\no sheet\n{lines}")
    for name, encoded in (("appended.vtu", 1), ("raw.vtu", 0)):
        writer = vtkXMLUnstructuredGridWriter()
        writer.SetInputData(BLOCK)
        writer.SetDataModeToAppended()
        writer.SetEncodeAppendedData(encoded)
        if not encoded:
            writer.SetCompressorTypeToNone()
        writer.SetFileName(str(folder / name))
        writer.Write()
    mesh = meshio.Mesh(np.asarray(BLOCK.points, float), [("tetra", BLOCK.cells_dict[10])])
    for name in ("a.msh", "a22.msh", "b.msh"):
        if name == "b.msh":
            mesh.point_data["fibre"] = np.asarray(BLOCK["fibre"])
        version = "gmsh22" if "22" in name else "gmsh"
        meshio.write(folder / name, mesh, file_format=version, binary=name[0] == "b")
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("name", TISSUE + SURFACES)
def test_whole_files_are_read_quietly(files, tmp_path, capfd, name):
    path = tmp_path / name
    kind = TETRAHEDRON if name in TISSUE else TRIANGLE
    cells = BLOCK.cells_dict[10] if name in TISSUE else SHEET.regular_faces
    corners = (BLOCK if name in TISSUE else SHEET).points[cells]
    for content in (files[name], files[name].rstrip() if name.startswith("a") else files[name]):
        path.write_bytes(content)
        if name == "a.obj" and not content.endswith(b"\n"):
            with pytest.raises(InputError, match="no line end at its end; add one if the file is"):
                read_mesh(path)
        else:
            mesh = read_mesh(path)
            found = mesh.points[mesh.require(kind, "cells")]
            np.testing.assert_allclose(found, corners, atol=1e-5)
            if name in WITH_FIBRES:
                np.testing.assert_allclose(mesh.point_data["fibre"], BLOCK["fibre"], atol=1e-5)
    assert capfd.readouterr() == ("", "")


def refused(path, content, capfd):
    """None if the file is refused, in one line and without other output; else its mesh."""
    path.write_bytes(content)
    capfd.readouterr()
    try:
        mesh = read_mesh(path)
    except InputError as error:
        message = str(error)
        assert message.startswith(f"{path}: ")
        assert message.isprintable()
        assert "; " in message
        mesh = None
    assert capfd.readouterr() == ("", "")
    return mesh


@pytest.mark.parametrize("name", TISSUE + SURFACES)
@pytest.mark.parametrize("cut", CUTS)
def test_truncated(files, tmp_path, capfd, name, cut):
    whole = files[name]
    content = whole[: int(cut * len(whole))] if 0 <= cut < 1 else whole[:cut]
    mesh = refused(tmp_path / name, content, capfd)
    if mesh is not None:
        # a cut between two arrays is no harm if the cells are all there, or none
        assert name.endswith(".vtk")
        cells = [len(mesh.cells.get(kind, ())) for kind in (TETRAHEDRON, TRIANGLE)]
        assert sum(cells) in (0, 384 if name in TISSUE else 128)
        # a last number that lost digits is still a number
        assert "fibre" not in mesh.point_data or -12 < cut < 0


@pytest.mark.parametrize("suffix", [".vtk", ".vtu", ".vtp", ".ply", ".stl", ".obj", ".msh"])
@pytest.mark.parametrize("content", RUBBISH.values(), ids=RUBBISH.keys())
def test_rubbish(tmp_path, capfd, suffix, content):
    assert refused(tmp_path / f"rubbish{suffix}", content, capfd) is None


@pytest.mark.parametrize("name", [n for n in TISSUE + SURFACES if not n.endswith("obj")])
def test_second_half_never_copied(files, tmp_path, capfd, name):
    whole = files[name]
    half = len(whole) // 2
    mesh = refused(tmp_path / name, whole[:half] + bytes(len(whole) - half), capfd)
    if mesh is not None:
        with pytest.raises(InputError, match="no cells in this file"):
            mesh.require(TRIANGLE, "cells")


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_ply_with_the_other_name_of_indices(tmp_path, newline):
    lines = ["ply", "format ascii 1.0", "element vertex 3", "property float x", "property float y",
             "property float z", "element face 1", "property list uchar int vertex_index",
             "end_header", "0 0 0", "1 0 0", "0 1 0", "3 0 1 2", ""]  # fmt: skip
    (tmp_path / "a.ply").write_bytes(newline.join(lines).encode())
    assert read_mesh(tmp_path / "a.ply").require(TRIANGLE, "triangles").tolist() == [[0, 1, 2]]


@pytest.mark.parametrize("newline", [b"\n", b"\r\n"])
@pytest.mark.parametrize("name", ["a.vtk", "sa.vtk"])
def test_text_vtk_without_arrays_or_with_long_title(tmp_path, name, newline):
    block = pv.ImageData(dimensions=(3, 3, 3)).cast_to_unstructured_grid().triangulate()
    sheet = pv.Plane(i_resolution=2, j_resolution=2).triangulate()
    data, kind = (block, TETRAHEDRON) if name == "a.vtk" else (sheet, TRIANGLE)
    data.clear_data()
    data.save(tmp_path / name, binary=False)
    content = (tmp_path / name).read_bytes().replace(b"vtk output", b"a title " * 20)
    content = content.replace(b"\n", newline)
    (tmp_path / name).write_bytes(content)
    assert len(read_mesh(tmp_path / name).require(kind, "cells")) == data.n_cells
    (tmp_path / name).write_bytes(content.rstrip()[:-1])
    with pytest.raises(InputError, match=r"contradicts itself|Error reading ascii"):
        read_mesh(tmp_path / name)
