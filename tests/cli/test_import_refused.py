"""`fascicle heart import` with parts or places that cannot be used: one line, nothing left."""

import json
import os
import pickle
import resource
import subprocess
import sys

import anatomies
import numpy as np
import pytest
import pyvista as pv

from fascicle.mesh.topology import without_unused_vertices

REMOVED = 40  # a triangle in the middle of a surface
WHAT = ["mesh", "fibres", "lv-endocardium", "rv-endocardium", "electrodes"]


class Trap:
    """Unpickling it makes a file."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return (open, (self.path, "w"))


class TestFiles:
    @pytest.mark.parametrize("what", WHAT)
    def test_no_file(self, materials, import_refused, what):
        suffix = ".csv" if what == "electrodes" else ".vtu"
        path = materials.folder / f"not there{suffix}"
        import_refused(path, "no such file", "; check", **{what: path})
        path.mkdir()
        import_refused(path, "not a file", "; check the path", **{what: path})

    @pytest.mark.parametrize(
        ("what", "suffix"), [("mesh", ".stp"), ("fibres", ""), ("electrodes", ".pkl")]
    )
    def test_other_suffixes_are_not_opened(self, materials, import_refused, what, suffix, tmp_path):
        path = materials.folder / f"thing{suffix}"
        path.write_bytes(pickle.dumps(Trap(tmp_path / "sprung")))
        import_refused(path, "cannot read", "use one of", **{what: path})
        assert not (tmp_path / "sprung").exists()

    @pytest.mark.parametrize(
        "name", ["a.vtk", "a.vtu", "a.vtp", "a.obj", "a.stl", "a.ply", "a.msh", "a.csv", "a.json"]
    )
    def test_renamed_pickles_are_not_opened(self, materials, import_refused, name, tmp_path):
        path = materials.folder / name
        path.write_bytes(pickle.dumps(Trap(tmp_path / "sprung")))
        what = "electrodes" if name.endswith(("csv", "json")) else "mesh"
        import_refused(path, "; ", **{what: path})
        assert not (tmp_path / "sprung").exists()
        pickle.loads(path.read_bytes()).close()
        assert (tmp_path / "sprung").exists()  # the trap does work


def tissue(m, points=None, tetrahedra=None, name="spoilt.vtu"):
    """Save the tissue with other points or tetrahedra, and straight fibres."""
    points = m.points if points is None else points
    tetrahedra = m.tetrahedra if tetrahedra is None else tetrahedra
    fibres = np.tile([1.0, 0.0, 0.0], (len(points), 1))
    return m.save(name, m.grid(points, tetrahedra, {"fibre": fibres}))


def edited(values, rows, change):
    """A copy with some rows changed."""
    values = values.copy()
    values[rows] = change(values[rows]) if callable(change) else change
    return values


def mixed(m):
    cells = {pv.CellType.TETRA: m.tetrahedra, pv.CellType.PENTAGONAL_PRISM: np.arange(10)[None]}
    return m.save("mixed.vtu", pv.UnstructuredGrid(cells, m.points))


def gapped(m):
    x = m.points[m.tetrahedra].mean(axis=1)[:, 0]
    return tissue(m, tetrahedra=m.tetrahedra[(x < 37.5) | (x > 45)])


def beyond_the_points(m):
    file = tissue(m, name="spoilt.vtk")
    content = file.read_bytes()
    at = content.index(b"CONNECTIVITY vtktypeint64\n") + len(b"CONNECTIVITY vtktypeint64\n")
    file.write_bytes(content[: at + 1] + b"\x7f" + content[at + 2 :])
    return file


def folded_blocks(m):
    image = pv.ImageData(dimensions=(4, 4, 4), spacing=(20, 20, 20))
    blocks = image.cast_to_unstructured_grid()
    blocks.points[21] += 25  # mm, beyond the block's opposite corner
    return m.save("blocks.vtu", blocks)


def swap(corners):
    return corners[:, [1, 0, 2, 3]]


TISSUES = {
    "a surface": (lambda m: m.files["lv-endocardium"], "no tetrahedra", "give a mesh that has"),
    "points alone": (lambda m: m.save("cloud.vtp", pv.PolyData(m.points)),
                     "no tetrahedra in this file (729 points"),
    "folded hexahedra": (folded_blocks, " of 27 voxels are flat or folded", "; correct the order"),
    "others among them": (mixed, "3072 tetrahedra, but also other cells", "1 Pentag", "; make"),
    "no volume": (lambda m: tissue(m, None, edited(m.tetrahedra, [812, 900], 5)),
                  "2 of 3072 tetrahedra have zero volume (first: 812 at ("),
    "inverted": (lambda m: tissue(m, None, edited(m.tetrahedra, [7, 8, 9], swap)),
                 "3 of 3072 tetrahedra are inverted (first: 7 at (", ") mm, 8 at (",
                 ") mm, 9 at (", ") mm); remove them or remesh"),
    "all inverted": (lambda m: tissue(m, None, swap(m.tetrahedra)),
                     "3072 of 3072", "inverted", "; swap two vertices"),
    "nan": (lambda m: tissue(m, edited(m.points, [5, 70], np.nan)),
            "2 of 729 points have", "not finite (first: 5 at (nan, nan, nan) mm, 70 at ("),
    "no unit": (lambda m: tissue(m, m.points * 1e12), "largest extent is 6e+13", "; check the"),
    "there twice": (lambda m: tissue(m, None, np.vstack([m.tetrahedra, m.tetrahedra[100:110]])),
                    "tetrahedra overlap others", "; remove what is there twice"),
    "two pieces": (gapped, "2 unconnected pieces: ", "(first: ", "heart build' joins them"),
    "corners that are no points": (beyond_the_points, "points that are not there"),
}  # fmt: skip


def fibres(m, values=None, *, points=None, tetrahedra=None, **more):
    """Save fibres of the tissue, as they are or spoilt, with more arrays of points."""
    points = m.points if points is None else points
    arrays = more if values is None else {"fibre": values, **more}
    return m.save("fibres.vtk", m.grid(points, m.tetrahedra, arrays))


def of_cells(m, values):
    """Save fibres of the first tetrahedra."""
    mesh = m.grid(m.points, m.tetrahedra[: len(values)], None, {"fibre": values})
    return m.save("cells.vtu", mesh)


def part_of_the_points(m):
    cloud = pv.PolyData(m.points[:-3])
    cloud.point_data["fibre"] = m.fibres[:-3]
    return m.save("part.vtp", cloud)


FIBRES = {
    "none": (lambda m: m.files["mesh"], "need one array of fibre", "found none", "; keep one"),
    "several": (lambda m: fibres(m, f=m.fibres, s=m.fibres), "found f, s", "name it 'fibre'"),
    "nan": (lambda m: fibres(m, edited(m.fibres, [11, 12, 13], np.nan)), "3 of 729 fibres are not"),
    "zero": (lambda m: fibres(m, edited(m.fibres, [20], 0)),
             "1 of 729 fibres have zero length (first: 20 at ("),
    "zero of cells": (lambda m: of_cells(m, np.zeros((3072, 3))),
                      "no rule serves, as the mesh's boundary has no lv endocardium, rv"),
    "of another mesh": (lambda m: fibres(m, m.fibres, points=m.points + 0.5), "no fibre within",
                        "729 of 729 vertices", "; give fibres on the same mesh"),
    "of part of the vertices": (part_of_the_points, "3 of 729 vertices", "largest gap"),
    "of part of the cells": (lambda m: of_cells(m, np.eye(3)[np.arange(3062) % 3]),
                             "no fibre within", "10 of 3072 tetrahedra"),
}  # fmt: skip


def test_fibres_of_cells_go_before_those_of_points(materials, outside, run):
    from fascicle.heart.folder import load_heart

    mesh = materials.grid(materials.points, materials.tetrahedra, {"fibre": materials.fibres})
    mesh.cell_data["fibre"] = np.eye(3)[1 + np.arange(3072) % 2]
    file = materials.save("both.vtu", mesh)
    assert run(*materials.command(outside / "heart", fibres=file)).status == 0
    found = load_heart(outside / "heart").fibres
    np.testing.assert_array_equal(found, np.eye(3)[1 + np.arange(3072) % 2])


def cup(m, change):
    """Save the left endocardium after a change of its points and triangles."""
    return m.save("spoilt.vtp", m.surface(*change(*m.lv_surface)))


def closed(points, triangles):
    rim = np.arange(len(points) - 24, len(points))
    lid = np.column_stack([rim, np.roll(rim, -1), np.full(24, len(points))])
    return np.vstack([points, points[rim].mean(axis=0)]), np.vstack([triangles, lid])


def with_a_fin(points, triangles):
    fin = [*triangles[REMOVED, :2], len(points)]
    return np.vstack([points, [15.0, 30.0, 30.0]]), np.vstack([triangles, fin])


def with_a_handle(*_):
    """Two holes of a sheet joined by a tube leave one outer boundary."""
    plane = pv.Plane(center=(15, 30, 30), i_size=40, j_size=40).triangulate()
    points, triangles = np.asarray(plane.points, float), plane.regular_faces
    a, b = triangles[42], triangles[151]
    tube = []
    for k in range(3):  # the second hole is run through the other way
        p, q, r, s = a[k], a[(k + 1) % 3], b[-k % 3], b[(-k - 1) % 3]
        tube += [[p, q, r], [q, s, r]]
    return points, np.vstack([np.delete(triangles, [42, 151], axis=0), tube])


def moebius_strip(*_):
    n = 40
    angle = 2 * np.pi * np.arange(n) / n
    points = []
    for side in (-1, 1):
        r, z = 20 + 5 * side * np.cos(angle / 2), 5 * side * np.sin(angle / 2)
        points.append(np.column_stack([r * np.cos(angle), r * np.sin(angle), z]) + 30)
    below, above = np.arange(n), np.arange(n) + n
    after, over = np.r_[below[1:], above[0]], np.r_[above[1:], below[0]]
    triangles = [np.column_stack([below, after, above]), np.column_stack([after, over, above])]
    return np.vstack(points), np.vstack(triangles)


SURFACES = {
    "tetrahedra": (lambda m: m.files["mesh"], "no triangles", "; give a mesh that has"),
    "polygons": (lambda m: m.save("a.vtp", pv.Polygon(n_sides=6)), "no triangles", "1 Polygon"),
    "closed": (lambda m: cup(m, closed),
               "the surface is closed; cut it open at the base"),
    "a hole": (lambda m: cup(m, lambda p, t: (p, np.delete(t, REMOVED, axis=0))),
               "2 boundary loops", "; close all but the one at the base"),
    "a fin": (lambda m: cup(m, with_a_fin),
              "1 of 626 edges have more than two triangles (first: ", "; remove what meets"),
    "two pieces": (lambda m: cup(m, lambda p, t: (np.vstack([p, p + 0.5]),
                                                  np.vstack([t, t + len(p)]))),
                   "falls into 2 pieces", "; keep the one"),
    "unused points": (lambda m: cup(m, lambda p, t: (np.vstack([p, p[:3]]), t)),
                      "3 of 220 points belong to no triangle (first: 217 at (", "; remove them"),
    "a handle": (lambda m: cup(m, with_a_handle), "handles", "Euler", "; repair or remesh"),
    "a Möbius strip": (lambda m: cup(m, moebius_strip), "one-sided", "; remesh or"),
    "far away": (lambda m: cup(m, lambda p, t: (p + 200, t)),
                 "from the tissue's", "; give both in the same frame"),
    "metres": (lambda m: cup(m, lambda p, t: (p / 1000, t)),
               "its largest extent is 0.045 mm", "; give both in mm"),
    "the other one": (lambda m: m.files["rv-endocardium"], "same surface", "; give one for each"),
}  # fmt: skip


SPOILT = [(case, "mesh", "fibres") for case in TISSUES.items()]
SPOILT += [(case, "fibres") for case in FIBRES.items()]
SPOILT += [(case, "lv_endocardium") for case in SURFACES.items()]


@pytest.mark.parametrize("spoilt", SPOILT, ids=lambda spoilt: f"{spoilt[1]}: {spoilt[0][0]}")
def test_parts(materials, import_refused, spoilt):
    (_, (spoil, *words)), *parts = spoilt
    file = spoil(materials)
    import_refused(file, *words, **dict.fromkeys(parts, file))


@pytest.mark.parametrize(("which", "seed"), [("lv-root", 217), ("rv-direction", -1)])
def test_seeds_that_are_no_points(import_refused, which, seed):
    side, what = which.split("-")
    words = f"{side}.vtp", f"{side.upper()} {what} {seed}", "from 0 to 216"
    import_refused(*words, extra=(f"--{which}={seed}",))


def test_seeds_that_are_one(import_refused):
    words = "rv.vtp", "RV root and direction are the same point (7); give two"
    import_refused(*words, extra=("--rv-root", 7, "--rv-direction", 7))


class TestElectrodes:
    @pytest.fixture
    def rows(self, materials):
        return [line.split(",") for line in materials.files["electrodes"].read_text().split()]

    @pytest.fixture
    def refuse(self, materials, import_refused):
        def call(content, *words, name="spoilt.csv"):
            if isinstance(content, list):
                content = "\n".join(",".join(map(str, row)) for row in content) + "\n"
            content = content.encode() if isinstance(content, str) else content
            (file := materials.folder / name).write_bytes(content)
            return import_refused(file, *words, electrodes=file)

        return call

    def test_names(self, refuse, rows):
        refuse(rows[:3] + rows[5:], "electrodes missing: LL, V1; add")
        refuse([*rows, rows[5]], "electrode V2 is given twice; keep one")
        for lead in ("aVR", "x", "II", "V1;V2"):
            refuse([*rows, [lead, 1, 2, 3]], f"'{lead}' is not a name of an electrode; the nine")
        refuse([*rows, ["M", 1, 2, 3]], "Frank's electrodes", "A, C, E, F, H, I are missing")
        rows[3][0] = "VI"
        refuse(rows, "electrodes missing: ")

    @pytest.mark.parametrize("place", ["1,1e999,2", "1,,2", "1,left,2", "1"])
    def test_what_is_no_place(self, refuse, rows, place):
        rows[4] = ["V1", place]
        refuse(rows, "electrode V1 is at", "; give three finite numbers (mm)")

    def test_no_header(self, refuse, rows):
        refuse(rows[1:], "the first line is 'ra,", "; it must be name,x,y,z")
        semicolons = "\n".join(map(";".join, rows))
        refuse(semicolons, "the first line is 'name;x;y;z'; it must be")

    @pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00\x80" * 9, b'name,x,y,z\n"RA,1,2'])
    def test_rubbish(self, refuse, content):
        refuse(content, "; ")

    @pytest.mark.parametrize(
        "content",
        ["", "{", "[1, 2]", "3", '{"RA": 5}', "[" * 100_000, '{"RA": [1, 2, %s]}' % ("9" * 5000)],
    )
    def test_json_of_other_shape(self, refuse, content):
        refuse(content, "JSON", "; ", name="spoilt.json")

    @pytest.mark.parametrize(
        "place", ["[1, 2]", "[1, 2, 3, 4]", "[1, 2, NaN]", "[1, null, 3]", "[1, true, 3]",
                  "[1, [2], 3]", "[1, 2, 1%s]" % ("0" * 400)],
    )  # fmt: skip
    def test_json_place(self, refuse, place):
        words = "electrode RA is at", "; give three finite"
        refuse(f'{{"RA": {place}}}', *words, name="spoilt.json")

    def test_json_with_a_name_twice(self, refuse, rows):
        pairs = [f"{json.dumps(name)}: [{x}, {y}, {z}]" for name, x, y, z in [*rows[1:], rows[2]]]
        words = "electrode LA is given twice; keep one"
        refuse("{" + ", ".join(pairs) + "}", words, name="twice.json")

    def test_places_that_cannot_be(self, refuse, rows):
        inside = [*rows[:6], ["V3", 31, 29.5, 33], *rows[7:]]
        refuse(inside, "electrode V3 lies inside the tissue; check")
        far = [*rows[:2], ["LA", 9e3, 30, 40], *rows[3:]]
        refuse(far, "electrode LA is", "mm from the heart; check")

    @pytest.mark.parametrize(("factor", "shift"), [(1e-3, 0), (0.1, 100)])
    def test_in_metres_or_centimetres(self, refuse, rows, factor, shift):
        for row in rows[1:]:
            row[1:] = [float(x) * factor + shift for x in row[1:]]
        refuse(rows, "electrode", "mm")


class TestOut:
    def test_places_of_others(self, materials, outside, refused, monkeypatch):
        out = outside / "heart"
        out.write_text("mine")
        refused(materials.command(out), out, "is a file; give the path of a folder")
        refused(materials.command(out / "deeper"), out, "; choose another place")
        assert out.read_text() == "mine"
        assert list(outside.iterdir()) == [out]
        out.unlink()
        out.mkdir()
        (out / "thesis.tex").write_text("mine")
        refused(
            materials.command(out), "holds 'thesis.tex', which would be lost; give another --out"
        )
        (out / "heart.toml").write_text("mine")
        refused(materials.command(out), "holds 'thesis.tex', which would be lost")
        (out / "heart.toml").unlink()
        monkeypatch.chdir(outside)
        refused(materials.command("."), ".: is the folder you are in", "; give a folder of its own")
        refused(materials.command(".."), "..: is the folder you are in, or holds it")
        assert [path.name for path in outside.rglob("*")] == ["heart", "thesis.tex"]

    def test_missing_parents_are_made(self, materials, outside, run):
        assert run(*materials.command(outside / "a" / "b" / "heart")).status == 0
        assert (outside / "a" / "b" / "heart" / "heart.toml").is_file()

    def test_a_link_to_a_folder(self, materials, outside, run):
        (outside / "real").mkdir()
        (outside / "link").symlink_to(outside / "real")
        assert run(*materials.command(outside / "link")).status == 0
        assert (outside / "link").is_symlink()
        assert (outside / "real" / "heart.toml").is_file()

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
    def test_a_read_only_folder(self, materials, outside, refused):
        outside.chmod(0o555)
        refused(materials.command(outside / "heart"), outside, "; choose another place")
        outside.chmod(0o755)
        assert list(outside.iterdir()) == []

    def test_bad_input_leaves_a_good_heart(self, materials, outside, run, refused):
        out = outside / "heart"
        assert run(*materials.command(out)).status == 0
        before = {p.name: p.read_bytes() for p in out.iterdir()}
        refused(materials.command(out, electrodes=materials.folder / "none.csv"), "no such file")
        assert {p.name: p.read_bytes() for p in out.iterdir()} == before

    def test_full_disk(self, materials, outside):
        def limit():  # in place of a full disk: no file over 20 kB
            resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

        ended = subprocess.run(
            [sys.executable, "-m", "fascicle.cli", *materials.command(outside / "heart")],
            preexec_fn=limit, capture_output=True, text=True,
        )  # fmt: skip
        assert ended.returncode == 2, ended
        assert ended.stderr.startswith("error: ")
        assert ended.stderr.count("\n") == 1, ended.stderr
        assert "could not be written" in ended.stderr
        assert list(outside.iterdir()) == []


def test_endocardia_exchanged_or_the_epicardium(run, refused, tmp_path, outside):
    """Each by the name of its file; given as the message says, they are imported."""
    mesh, files = anatomies.tissue(), {}
    for label in (anatomies.LV, anatomies.RV, anatomies.EPI):
        surface = without_unused_vertices(mesh.vertices, mesh.having(label))
        files[label] = anatomies.write_surface(tmp_path / f"{label.name}.vtp", *surface)
    tissue = anatomies.write_vtu(tmp_path / "mesh.vtu", labelled=False)
    electrodes = anatomies.write_electrodes(tmp_path / "electrodes.csv")
    command = ["heart", "import", "--mesh", tissue, "--fibres", "rule", "--electrodes", electrodes,
               "--out", outside / "heart"]  # fmt: skip
    lv, rv, epicardium = files.values()
    for left, right, words in (
        (rv, lv, f"{rv}, {lv}: LV and RV endocardium seem to be swapped"),
        (epicardium, rv, f"{epicardium}: 100% of the tissue lies in the cavity that it lines"),
        (lv, epicardium, f"{epicardium}: 100% of the tissue"),
    ):
        refused([*command, "--lv-endocardium", left, "--rv-endocardium", right], words)
    assert run(*command, "--lv-endocardium", lv, "--rv-endocardium", rv).well
