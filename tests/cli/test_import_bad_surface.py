"""`fascicle heart import` with endocardia, seeds, electrodes or outputs that cannot be used."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys

import numpy as np
import pytest
import pyvista as pv

REMOVED = 40  # a triangle in the middle of the surface


def save(materials, points, triangles, name="spoilt.vtp"):
    return materials.save(name, pv.PolyData.from_regular_faces(np.asarray(points), triangles))


class TestEndocardium:
    @pytest.fixture
    def cup(self, materials):
        return materials.lv_surface

    @pytest.fixture
    def refuse(self, materials, import_refused):
        def call(points, triangles, *words, side="lv"):
            file = save(materials, points, triangles)
            return import_refused(file, *words, **{f"{side}_endocardium": file})

        return call

    def test_no_triangles(self, materials, import_refused):
        file = materials.files["mesh"]
        import_refused(file, "no triangles", "; give a mesh that has", lv_endocardium=file)

    def test_quadrilaterals(self, materials, import_refused):
        file = materials.save("quads.vtp", pv.Plane(i_resolution=4, j_resolution=4))
        import_refused(file, "no triangles", "16 Quad", lv_endocardium=file)

    def test_some_quadrilaterals(self, materials, import_refused, cup):
        faces = [[3, *t] for t in cup[1][2:].tolist()] + [[4, 0, 1, 2, 3]]
        mesh = pv.PolyData(cup[0], np.concatenate(faces))
        file = materials.save("some.vtp", mesh)
        import_refused(file, "but also other cells", "1 Quad", "; make", lv_endocardium=file)

    def test_closed(self, refuse, cup):
        points, triangles = cup
        rim = np.arange(len(points) - 24, len(points))
        lid = np.column_stack([rim, np.roll(rim, -1), np.full(24, len(points))])
        centre = points[rim].mean(axis=0)
        refuse(
            np.vstack([points, centre]), np.vstack([triangles, lid]),
            "no boundary loop (it is closed)", "; it must be open at the base",
        )  # fmt: skip

    def test_a_hole(self, refuse, cup):
        points, triangles = cup
        refuse(points, np.delete(triangles, REMOVED, axis=0), "2 boundary loops", "; it must be")

    def test_non_manifold_edge(self, refuse, cup):
        points, triangles = cup
        fin = [triangles[REMOVED, 0], triangles[REMOVED, 1], len(points)]
        refuse(
            np.vstack([points, [15.0, 30.0, 30.0]]), np.vstack([triangles, fin]),
            "1 non-manifold edges", "shared by 3 triangles", "; repair or remesh", side="rv",
        )  # fmt: skip

    def test_two_pieces(self, refuse, cup):
        points, triangles = cup
        refuse(
            np.vstack([points, points + 0.5]), np.vstack([triangles, triangles + len(points)]),
            "falls into 2 pieces", "; keep the one",
        )  # fmt: skip

    def test_unused_points(self, refuse, cup):
        points, triangles = cup
        refuse(
            np.vstack([points, points[:3]]), triangles,
            "3 of 220 points belong to no triangle; remove them",
        )  # fmt: skip

    def test_points_that_are_not_merged(self, refuse, cup):
        points, triangles = cup
        soup = np.arange(3 * len(triangles)).reshape(-1, 3)
        refuse(points[triangles].reshape(-1, 3), soup, f"falls into {len(triangles)} pieces")

    def test_a_handle(self, materials, refuse):
        # two holes of a sheet joined by a tube leave one outer boundary
        plane = pv.Plane(
            center=(15, 30, 30), i_size=40, j_size=40, i_resolution=10, j_resolution=10
        ).triangulate()
        points, triangles = np.asarray(plane.points, float), plane.regular_faces
        a, b = triangles[42], triangles[151]
        kept = np.delete(triangles, [42, 151], axis=0)
        tube = []
        for k in range(3):  # the second hole is run through the other way
            p, q = a[k], a[(k + 1) % 3]
            r, s = b[-k % 3], b[(-k - 1) % 3]
            tube += [[p, q, r], [q, s, r]]
        refuse(points, np.vstack([kept, tube]), "handles", "Euler", "; repair or remesh")

    def test_moebius_strip(self, refuse):
        n = 40
        angle = 2 * np.pi * np.arange(n) / n
        points = []
        for side in (-1, 1):
            r = 20 + 5 * side * np.cos(angle / 2)
            points.append(
                np.column_stack(
                    [r * np.cos(angle), r * np.sin(angle), 5 * side * np.sin(angle / 2)]
                )
            )
        below, above = np.arange(n), np.arange(n) + n
        next_below = np.r_[below[1:], above[0]]
        next_above = np.r_[above[1:], below[0]]
        triangles = np.vstack(
            [
                np.column_stack([below, next_below, above]),
                np.column_stack([next_below, next_above, above]),
            ]
        )
        refuse(np.vstack(points) + 30, triangles, "boundary loops", "; it must be")

    def test_far_from_the_tissue(self, refuse, cup):
        points, triangles = cup
        refuse(points + 200, triangles, "from the tissue's", "; give both in the same frame")

    def test_in_metres(self, refuse, cup):
        points, triangles = cup
        refuse(points / 1000, triangles, "its largest extent is 0.045 mm", "; give both in mm")
        refuse(points / 10, triangles, "its largest extent is 4.5 mm", "; give both in mm")

    def test_not_finite(self, refuse, cup):
        points, triangles = cup
        points = points.copy()
        points[3, 0] = np.nan
        refuse(points, triangles, "1 of 217 points", "not finite (first: point 3); correct")

    def test_the_same_one_twice(self, materials, import_refused):
        file = materials.files["lv-endocardium"]
        import_refused(file, "same surface", "; give one for each", rv_endocardium=file)


class TestSeeds:
    @pytest.mark.parametrize("seed", [217, -1, 10**6])
    @pytest.mark.parametrize("which", ["lv-root", "lv-direction", "rv-root", "rv-direction"])
    def test_out_of_range(self, import_refused, which, seed):
        side, what = which.split("-")
        import_refused(
            f"{side}.vtp", f"{side.upper()} {what} {seed}", "from 0 to 216",
            extra=(f"--{which}={seed}",),
        )  # fmt: skip

    def test_root_is_direction(self, import_refused):
        import_refused(
            "rv.vtp", "RV root and direction are the same point (7); give two",
            extra=("--rv-root", 7, "--rv-direction", 7),
        )  # fmt: skip


class TestElectrodes:
    @pytest.fixture
    def rows(self, materials):
        return [line.split(",") for line in materials.files["electrodes"].read_text().split()]

    @pytest.fixture
    def refuse(self, materials, import_refused, rows):
        def call(rows, *words):
            file = materials.folder / "spoilt.csv"
            file.write_text("\n".join(",".join(map(str, row)) for row in rows) + "\n")
            return import_refused(file, *words, electrodes=file)

        return call

    def test_missing(self, refuse, rows):
        refuse(rows[:3] + rows[5:], "electrodes missing: LL, V1; add")

    def test_misnamed(self, refuse, rows):
        rows[3][0] = "RL"
        refuse(rows, "unknown electrode 'RL'; the nine are RA, LA, LL, V1")

    def test_twice(self, refuse, rows):
        refuse([*rows, rows[5]], "electrode V2 is given twice; keep one")

    @pytest.mark.parametrize("value", ["nan", "inf", "", "12,5", "left", "1e999"])
    def test_not_a_position(self, refuse, rows, value):
        rows[4][2] = value
        words = ("electrode V1 is at", "; give three finite numbers (mm)")
        if value == "12,5":  # a decimal comma is one column too many
            rows[4] = ["V1", "12", "x5", "3"]
        refuse(rows, *words)

    def test_short_row(self, refuse, rows):
        rows[4] = rows[4][:2]
        refuse(rows, "electrode V1 is at", "; give three")

    def test_no_header(self, refuse, rows):
        refuse(rows[1:], "the first line is 'ra,", "; it must be name,x,y,z")

    def test_semicolons(self, materials, import_refused):
        file = materials.folder / "semi.csv"
        file.write_text(materials.files["electrodes"].read_text().replace(",", ";"))
        import_refused(file, "the first line is 'name;x;y;z'; it must be", electrodes=file)

    @pytest.mark.parametrize(
        "content",
        [b"", b"\n\n", b"\xff\xfe\x00\x80" * 9, bytes(range(256)), b'name,x,y,z\n"RA,1,2'],
    )
    def test_rubbish(self, materials, import_refused, content):
        file = materials.folder / "rubbish.csv"
        file.write_bytes(content)
        import_refused(file, "; ", electrodes=file)

    @pytest.mark.parametrize(
        "content",
        ["", "{", "[1, 2]", "3", '{"RA": 5}', "[" * 100_000, '{"RA": [1, 2, %s]}' % ("9" * 5000)],
    )
    def test_json_of_other_shape(self, materials, import_refused, content):
        file = materials.folder / "spoilt.json"
        file.write_text(content)
        import_refused(file, "JSON", "; ", electrodes=file)

    @pytest.mark.parametrize(
        "place", ["[1, 2]", "[1, 2, 3, 4]", "[1, 2, NaN]", "[1, null, 3]", "[1, true, 3]",
                  "[1, [2], 3]", "[1, 2, 1%s]" % ("0" * 400)],
    )  # fmt: skip
    def test_json_place(self, materials, import_refused, place):
        file = materials.folder / "spoilt.json"
        file.write_text(f'{{"RA": {place}}}')
        import_refused(file, "electrode RA is at", "; give three finite", electrodes=file)

    def test_json_with_a_name_twice(self, materials, import_refused, rows):
        pairs = [f"{json.dumps(name)}: [{x}, {y}, {z}]" for name, x, y, z in [*rows[1:], rows[2]]]
        file = materials.folder / "twice.json"
        file.write_text("{" + ", ".join(pairs) + "}")
        import_refused(file, "electrode LA is given twice; keep one", electrodes=file)

    def test_inside_the_tissue(self, refuse, rows):
        rows[6][1:] = [31, 29.5, 33]
        refuse(rows, "electrode V3 lies inside the tissue; check")

    @pytest.mark.parametrize("factor", [1e-3, 0.1])
    @pytest.mark.parametrize("shift", [0, 100])
    def test_in_metres_or_centimetres(self, refuse, rows, factor, shift):
        for row in rows[1:]:
            row[1:] = [float(x) * factor + shift for x in row[1:]]
        refuse(rows, "electrode", "mm")

    def test_far_away(self, refuse, rows):
        rows[2][1] = 9e3
        refuse(rows, "electrode LA is", "mm from the heart; check")


class TestOut:
    def test_a_file(self, materials, outside, refused):
        out = outside / "heart"
        out.write_text("mine")
        refused(materials.command(out), out, "is a file; give the path of a folder")
        assert out.read_text() == "mine"
        assert list(outside.iterdir()) == [out]

    def test_a_folder_with_somebodys_file(self, materials, outside, refused):
        out = outside / "heart"
        out.mkdir()
        (out / "thesis.tex").write_text("mine")
        refused(
            materials.command(out), out, "holds files and is not a heart folder", "another --out"
        )
        assert [p.name for p in out.iterdir()] == ["thesis.tex"]
        assert list(outside.iterdir()) == [out]

    def test_missing_parents_are_made(self, materials, outside, run):
        assert run(*materials.command(outside / "a" / "b" / "heart")).status == 0
        assert (outside / "a" / "b" / "heart" / "heart.toml").is_file()

    def test_parent_is_a_file(self, materials, outside, refused):
        (outside / "a").write_text("mine")
        out = outside / "a" / "heart"
        refused(materials.command(out), out, "; choose another place")
        assert [p.name for p in outside.iterdir()] == ["a"]

    def test_the_folder_one_is_in(self, materials, outside, refused, monkeypatch):
        monkeypatch.chdir(outside)
        refused(materials.command("."), ".: is the folder you are in", "; give a folder of its own")
        refused(materials.command(".."), "..: is the folder you are in, or holds it")
        assert list(outside.iterdir()) == []

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
