"""`fascicle heart import` with tissue or fibres that cannot be used: one line, nothing left."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import pyvista as pv


def grid(points, tetrahedra, **point_data):
    mesh = pv.UnstructuredGrid({pv.CellType.TETRA: np.asarray(tetrahedra)}, np.asarray(points))
    mesh.point_data.update(point_data)
    return mesh


class Trap:
    """Unpickling it makes a file."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return (open, (self.path, "w"))


def save_tissue(materials, points=None, tetrahedra=None, name="spoilt.vtu"):
    points = materials.points if points is None else points
    tetrahedra = materials.tetrahedra if tetrahedra is None else tetrahedra
    fibres = np.tile([1.0, 0.0, 0.0], (len(points), 1))
    return materials.save(name, grid(points, tetrahedra, fibre=fibres))


WHAT = ["mesh", "fibres", "lv-endocardium", "rv-endocardium", "electrodes"]


class TestFiles:
    @pytest.mark.parametrize("what", WHAT)
    def test_missing(self, materials, import_refused, what):
        path = materials.folder / "not there.vtu"
        path = path.with_suffix(".csv") if what == "electrodes" else path
        import_refused(path, "no such file", "; check", **{what: path})

    @pytest.mark.parametrize("what", WHAT)
    def test_a_folder(self, materials, import_refused, what):
        path = materials.folder / ("folder.csv" if what == "electrodes" else "folder.vtu")
        path.mkdir()
        import_refused(path, "not a file", "; check the path", **{what: path})

    @pytest.mark.parametrize("what", WHAT)
    @pytest.mark.parametrize("suffix", [".txt", "", ".stp"])
    def test_wrong_suffix(self, materials, import_refused, what, suffix):
        path = materials.folder / f"thing{suffix}"
        path.write_text("hello\n")
        import_refused(path, "cannot read", "use one of", **{what: path})

    @pytest.mark.parametrize("what", WHAT)
    @pytest.mark.parametrize("suffix", [".pkl", ".pickle", ".npy"])
    def test_pickles_are_not_opened(self, materials, import_refused, what, suffix, tmp_path):
        path = materials.folder / f"thing{suffix}"
        path.write_bytes(pickle.dumps(Trap(tmp_path / "sprung")))
        import_refused(path, "cannot read", "use one of", **{what: path})
        assert not (tmp_path / "sprung").exists()

    @pytest.mark.parametrize(
        "name", ["a.vtk", "a.vtu", "a.vtp", "a.obj", "a.stl", "a.ply", "a.msh", "a.csv", "a.json"]
    )
    @pytest.mark.parametrize("protocol", [0, 4])
    def test_renamed_pickles_are_not_opened(
        self, materials, import_refused, name, protocol, tmp_path
    ):
        path = materials.folder / name
        path.write_bytes(pickle.dumps(Trap(tmp_path / "sprung"), protocol=protocol))
        what = "electrodes" if name.endswith(("csv", "json")) else "mesh"
        import_refused(path, "; ", **{what: path})
        assert not (tmp_path / "sprung").exists()
        pickle.loads(path.read_bytes()).close()
        assert (tmp_path / "sprung").exists()  # the trap does work


class TestTetrahedra:
    def test_none(self, materials, import_refused):
        import_refused(
            "lv.vtp",
            "no tetrahedra",
            "give a mesh that has",
            mesh=materials.files["lv-endocardium"],
        )

    def test_points_alone(self, materials, import_refused):
        file = materials.save("cloud.vtp", pv.PolyData(materials.points))
        import_refused(file, "no tetrahedra in this file (729 points", mesh=file)

    def test_hexahedra(self, materials, import_refused):
        blocks = pv.ImageData(dimensions=(4, 4, 4), spacing=(20, 20, 20))
        file = materials.save("blocks.vtu", blocks.cast_to_unstructured_grid())
        import_refused(file, "no tetrahedra", "other cells: 27", mesh=file)

    def test_tetrahedra_and_others(self, materials, import_refused):
        mesh = pv.UnstructuredGrid(
            {
                pv.CellType.TETRA: materials.tetrahedra,
                pv.CellType.PYRAMID: np.array([[0, 1, 2, 3, 4]]),
            },
            materials.points,
        )
        file = materials.save("mixed.vtu", mesh)
        import_refused(
            file, "3072 tetrahedra, but also other cells", "1 Pyramid", "; make", mesh=file
        )

    def test_zero_volume(self, materials, import_refused):
        spoilt = materials.tetrahedra.copy()
        spoilt[[812, 900], 1] = spoilt[[812, 900], 0]
        file = save_tissue(materials, tetrahedra=spoilt)
        import_refused(
            file, "2 of 3072 tetrahedra have zero volume (first: 812); remove them or remesh",
            mesh=file,
        )  # fmt: skip

    def test_flat(self, materials, import_refused):
        file = save_tissue(materials, points=materials.points * [1, 1, 0])
        import_refused(file, "3072 of 3072 tetrahedra have zero volume", mesh=file, fibres=file)

    def test_inverted(self, materials, import_refused):
        spoilt = materials.tetrahedra.copy()
        spoilt[[7, 8, 9]] = spoilt[[7, 8, 9]][:, [1, 0, 2, 3]]
        file = save_tissue(materials, tetrahedra=spoilt)
        import_refused(file, "3 of 3072 tetrahedra are inverted (first: 7); remove", mesh=file)

    def test_all_inverted(self, materials, import_refused):
        file = save_tissue(materials, tetrahedra=materials.tetrahedra[:, [1, 0, 2, 3]])
        import_refused(file, "3072 of 3072", "inverted", "; swap two vertices", mesh=file)

    @pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
    def test_coordinates_not_finite(self, materials, import_refused, value):
        points = materials.points.copy()
        points[[5, 70], 1] = value
        file = save_tissue(materials, points=points)
        import_refused(
            file, "2 of 729 points have coordinates that are not finite (first: point 5); correct",
            mesh=file,
        )  # fmt: skip

    @pytest.mark.parametrize(
        ("factor", "unit", "advice"),
        [(1e-3, "metres", "by 1000"), (0.1, "centimetres", "by 10 "), (1e3, "micro", "by 0.001")],
    )
    def test_units(self, materials, import_refused, factor, unit, advice):
        file = save_tissue(materials, points=materials.points * factor)
        import_refused(file, unit, f"; multiply the coordinates {advice}", mesh=file, fibres=file)

    def test_size_of_nothing_known(self, materials, import_refused):
        file = save_tissue(materials, points=materials.points * 1e12)
        import_refused(file, "largest extent is 6e+13", "; check the units", mesh=file)

    def test_there_twice(self, materials, import_refused):
        twice = np.vstack([materials.tetrahedra, materials.tetrahedra[100:110]])
        file = save_tissue(materials, tetrahedra=twice)
        import_refused(file, "tetrahedra overlap others", "; remove what is there twice", mesh=file)

    def test_two_pieces(self, materials, import_refused):
        centre = materials.points[materials.tetrahedra].mean(axis=1)
        kept = materials.tetrahedra[(centre[:, 0] < 37.5) | (centre[:, 0] > 45)]
        file = save_tissue(materials, tetrahedra=kept)
        import_refused(file, "2 unconnected pieces", "; keep one piece", mesh=file)

    def test_cells_beyond_the_points(self, materials, import_refused):
        file = save_tissue(materials, name="spoilt.vtk")
        content = file.read_bytes()
        at = content.index(b"CONNECTIVITY vtktypeint64\n") + len(b"CONNECTIVITY vtktypeint64\n")
        file.write_bytes(content[: at + 1] + b"\x7f" + content[at + 2 :])
        import_refused(file, "points that are not there", mesh=file, fibres=file)


class TestFibres:
    def refuse(self, materials, import_refused, values, *words, **options):
        mesh = grid(materials.points, materials.tetrahedra, fibre=values)
        file = materials.save("fibres.vtk", mesh)
        return import_refused(file, *words, fibres=file, **options)

    def test_no_array(self, materials, import_refused):
        file = materials.files["mesh"]
        import_refused(file, "need one array of fibre", "found none", "; keep one", fibres=file)

    def test_scalars_only(self, materials, import_refused):
        self.refuse(materials, import_refused, materials.points[:, 0].copy(), "found none")

    def test_several_arrays(self, materials, import_refused):
        mesh = grid(materials.points, materials.tetrahedra, f=materials.fibres, s=materials.fibres)
        file = materials.save("several.vtu", mesh)
        import_refused(file, "found f, s", "name it 'fibre'", fibres=file)

    def test_several_with_known_names(self, materials, import_refused):
        fibres = materials.fibres
        mesh = grid(materials.points, materials.tetrahedra, fibre=fibres, fiber=fibres)
        file = materials.save("several.vtu", mesh)
        import_refused(file, "need one array", "fibre", "fiber", "; keep one", fibres=file)

    def test_cells_go_before_points_of_the_same_name(self, materials, outside, run):
        from fascicle.heart.folder import load_heart

        mesh = grid(materials.points, materials.tetrahedra, fibre=materials.fibres)
        mesh.cell_data["fibre"] = np.tile([0.0, 1.0, 0.0], (3072, 1))
        file = materials.save("both.vtu", mesh)
        assert run(*materials.command(outside / "heart", fibres=file)).status == 0
        np.testing.assert_array_equal(load_heart(outside / "heart").fibres[:, 1], 1.0)

    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_not_finite(self, materials, import_refused, value):
        values = materials.fibres.copy()
        values[[11, 12, 13], 2] = value
        self.refuse(materials, import_refused, values, "3 of 729 fibres are not finite, or")

    def test_zero(self, materials, import_refused):
        values = materials.fibres.copy()
        values[20] = 0
        self.refuse(
            materials, import_refused, values, "1 of 729 fibres have zero length (first: 20); give"
        )

    def test_zero_per_cell(self, materials, import_refused):
        mesh = grid(materials.points, materials.tetrahedra)
        mesh.cell_data["fibre"] = np.zeros((3072, 3))
        file = materials.save("zero.vtu", mesh)
        import_refused(file, "3072 of 3072 fibres have zero length", fibres=file)

    def test_of_another_mesh(self, materials, import_refused):
        mesh = grid(materials.points + 0.5, materials.tetrahedra, fibre=materials.fibres)
        file = materials.save("moved.vtu", mesh)
        import_refused(
            file, "no fibre within", "729 of 729 vertices", "; give fibres on the same mesh",
            fibres=file,
        )  # fmt: skip

    def test_in_other_units(self, materials, import_refused):
        mesh = grid(materials.points / 1000, materials.tetrahedra, fibre=materials.fibres)
        file = materials.save("metres.vtu", mesh)
        import_refused(file, "no fibre within", "same mesh", fibres=file)

    def test_part_of_the_vertices(self, materials, import_refused):
        cloud = pv.PolyData(materials.points[:-3])
        cloud.point_data["fibre"] = materials.fibres[:-3]
        file = materials.save("part.vtp", cloud)
        import_refused(file, "3 of 729 vertices", "largest gap", fibres=file)

    def test_per_cell_of_another_mesh(self, materials, import_refused):
        mesh = grid(materials.points, materials.tetrahedra[:-10])
        mesh.cell_data["fibre"] = np.tile([1.0, 0, 0], (len(materials.tetrahedra) - 10, 1))
        file = materials.save("part.vtu", mesh)
        import_refused(file, "no fibre within", "10 of 3072 tetrahedra", fibres=file)
