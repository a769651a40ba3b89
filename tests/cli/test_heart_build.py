"""`fascicle heart build` on thick-walled ventricles: every kind of input, every option."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import anatomies
import numpy as np
import pytest
from anatomies import CENTRE_X, EDGE, HALF_AXES, LV, NETWORK, RV, SCAR_CENTRE, SCAR_RADIUS

import fascicle
from fascicle.build.check import cavity_volume
from fascicle.build.meshing import mesh_surface
from fascicle.core.leads import ELECTRODES
from fascicle.forward.scenario_files import read_scenario
from fascicle.heart.heart import digest_of
from fascicle.heart.labelled_surface import LabelledMesh
from fascicle.mesh.topology import boundary_loops
from fascicle.torso.lead_fields import place_electrodes

pytestmark = pytest.mark.usefixtures("blank_pictures")
BLOOD_AND_SCAR = "lv=1,rv=2,myocardium=3,scar=4"
SURFACE_KINDS = {
    "labelled": lambda folder: [anatomies.write_labelled(folder / "heart.vtp")],
    "another array": lambda folder: [
        anatomies.write_surface(
            folder / "heart.vtk",
            part=10 * anatomies.ventricles().labels,
            number=np.arange(len(anatomies.ventricles().labels)),
        ),
        *("--label-array", "part", "--labels", "base=10,epicardium=20,lv=30,rv=40"),
    ],
    "unlabelled STL": lambda folder: [anatomies.write_surface(folder / "heart.stl")],
    "parts": lambda folder: anatomies.options_of(anatomies.write_parts(folder)),
    "parts 1 mm apart": lambda folder: anatomies.options_of(anatomies.write_parts(folder, 1.0)),
    "parts without base": lambda folder: anatomies.options_of(
        anatomies.write_parts(folder), "base"
    ),
}


MESHED: dict[str, LabelledMesh] = {}
SIMULATED: set[str] = set()  # digests of hearts


@pytest.fixture(autouse=True)
def meshed_once(monkeypatch):
    """Mesh no surface twice: one that is the same to the last bit gives the same mesh."""

    def mesh(surface, edge_length, progress=None):
        arrays = (surface.vertices, surface.triangles, surface.labels, np.array(edge_length))
        key = digest_of(*arrays)
        if key not in MESHED:
            MESHED[key] = mesh_surface(surface, edge_length, progress)
        return replace(MESHED[key], name=surface.name)

    monkeypatch.setattr("fascicle.build.read_anatomy.mesh_surface", mesh)


@pytest.fixture
def build(run, tmp_path):
    """Build a heart in an unbounded conductor; the heart, and how the command ended."""
    electrodes = anatomies.write_electrodes(tmp_path / "electrodes.csv")

    def call(*arguments, out=None, edge_length=EDGE):
        out = out if out is not None else tmp_path / "built"
        around = ["--torso", "none", "--electrodes", electrodes, "--edge-length", edge_length]
        ended = run("heart", "build", *arguments, *around, "--out", out)
        assert ended.status == 0, ended
        return fascicle.load_heart(out), ended

    return call


def off_ellipsoid(vertices, label):
    """How far points lie from an exact half-ellipsoid (share of its half-axes)."""
    straight = vertices - [CENTRE_X[label], 0, 0]
    straight[:, 0] += anatomies.BEND[label] * vertices[:, 1] ** 2
    return np.abs(np.linalg.norm(straight / HALF_AXES[label], axis=1) - 1)


def assert_ventricles(heart):
    """The heart is that of `anatomies`: volumes, endocardia, directions; and it simulates.

    Faces of 8 mm cut corners of cavities 20 mm in radius: of a circle, such chords leave
    sin(8/20)/(8/20) = 97 %.
    """
    assert heart.volumes.sum() / 1000 == pytest.approx(anatomies.MYOCARDIUM, rel=0.02)
    for endocardium, label in ((heart.lv, LV), (heart.rv, RV)):
        assert np.median(off_ellipsoid(endocardium.vertices, label)) < 0.03
        exact = anatomies.volume_below(label)
        assert cavity_volume(endocardium) == pytest.approx(exact, rel=0.1)
        assert len(boundary_loops(endocardium.triangles)) == 1
    assert np.abs(np.linalg.norm(heart.fibres, axis=1) - 1).max() < 1e-12
    if heart.sheets is not None:
        assert np.abs(np.linalg.norm(heart.sheets, axis=1) - 1).max() < 1e-9
        assert np.abs(np.einsum("ij,ij->i", heart.fibres, heart.sheets)).max() < 1e-9
    if heart.digest in SIMULATED:
        return
    SIMULATED.add(heart.digest)
    simulation = fascicle.ForwardModel(heart).simulate(NETWORK)
    assert not simulation.unreached.any()
    assert 40 < simulation.total_activation_time < 200  # ms
    assert np.abs(simulation.leads).max() > 0.1  # mV


@pytest.mark.parametrize("kind", SURFACE_KINDS)
def test_surfaces(build, tmp_path, kind):
    # borders that are found are smoothed, which takes a little off rims and cavities: off the
    # longest edge for which walls have room, and off an LV of 41 ml, where 40 is unusually little
    found = "unlabelled" in kind
    heart, ended = build(*SURFACE_KINDS[kind](tmp_path), edge_length=7.8 if found else EDGE)
    assert_ventricles(heart)
    warnings = [line for line in ended.err.splitlines() if line.startswith("warning: ")]
    # faces of 8 mm take more than 3 % off the cavities, and no more than that is wrong
    assert any("LV cavity" in w and "; give a shorter edge length" in w for w in warnings)
    others = [w for w in warnings if "edge length" not in w]
    assert not [w for w in others if not (found and w.startswith("warning: LV cavity: 39."))]
    assert "volumes: LV cavity" in ended.out
    assert ("labels were found, not given: look at" in ended.out) == ("unlabelled" in kind)
    assert (heart.folder / "labels.png").exists() == ("unlabelled" in kind)
    assert heart.sheets is not None
    assert heart.regions is None
    assert heart.edge_length == pytest.approx(EDGE, rel=0.05)
    if kind == "labelled":  # another run of the mesher gives the same
        np.testing.assert_array_equal(heart.vertices, anatomies.tissue().vertices)
        np.testing.assert_array_equal(heart.tetrahedra, anatomies.tissue().tetrahedra)


def test_a_segmentation_with_scar(build, tmp_path, monkeypatch):
    # cubes of 3 mm instead of 1: walls of 11 mm need no more, and it is several times as fast
    monkeypatch.setattr("fascicle.build.segmentation_surface.Grid.edge", 3.0)
    file = anatomies.write_nifti(tmp_path / "heart.nii.gz")
    heart, ended = build(file, "--labels", BLOOD_AND_SCAR, edge_length=7.5)
    assert_ventricles(replace(heart, values={}))  # in which the scar conducts
    assert "scar: region 1" in ended.out
    assert np.unique(heart.regions).tolist() == [0, 1]
    assert heart.values == {"region_1_conductivity": 0.0}  # in heart.toml
    assert fascicle.ForwardModel(heart).simulate(NETWORK).unreached.any()
    scar = heart.regions == 1
    assert heart.volumes[scar].sum() / 1000 == pytest.approx(anatomies.scar_volume(), rel=0.1)
    centres = heart.vertices[heart.tetrahedra].mean(axis=1)
    distance = np.linalg.norm(centres - SCAR_CENTRE, axis=1)
    assert distance[scar].max() < SCAR_RADIUS + anatomies.VOXEL
    # next to a surface, the middle of a tetrahedron can lie in a voxel of blood
    assert scar[distance < SCAR_RADIUS - anatomies.VOXEL].mean() > 0.97


def test_scar_that_does_not_conduct_is_never_reached(build, tmp_path):
    labelled = anatomies.write_vtu(tmp_path / "heart.vtu", labelled=True, scar=True)
    heart, _ = build(labelled)
    scenario = tmp_path / "scar.toml"
    scenario.write_text("[[region]]\nlabel = 1\nconductivity = 0.0\n")
    _, regions = read_scenario(scenario)
    model = fascicle.ForwardModel(heart, fascicle.Conduction(regions=regions))
    unreached = model.simulate(NETWORK).unreached
    scar = heart.regions == 1
    only_scar = np.setdiff1d(heart.tetrahedra[scar], heart.tetrahedra[~scar])
    assert len(only_scar) > 20
    np.testing.assert_array_equal(np.flatnonzero(unreached), only_scar)
    assert not fascicle.ForwardModel(heart).simulate(NETWORK).unreached.any()


@pytest.mark.parametrize("labelled", [True, False])
def test_tetrahedra_stay_as_they_are(build, tmp_path, labelled):
    mesh = anatomies.tissue()
    file = anatomies.write_vtu(tmp_path / "heart.vtu", labelled=labelled)
    heart, ended = build(file, edge_length=2.0)  # of no consequence here
    np.testing.assert_array_equal(heart.vertices, mesh.vertices)
    np.testing.assert_array_equal(heart.tetrahedra, mesh.tetrahedra)
    assert ("labels were found, not given: look at" in ended.out) == (not labelled)
    assert "mesh: as in the file" in ended.out
    assert_ventricles(heart)


@pytest.fixture
def mesh_file(tmp_path):
    """Labelled tetrahedra, from which a heart is built in a second."""
    return anatomies.write_vtu(tmp_path / "mesh.vtu", labelled=True)


def test_named_after_the_file_and_written_where_one_is(run, tmp_path, mesh_file, monkeypatch):
    monkeypatch.chdir(tmp_path)
    electrodes = anatomies.write_electrodes(tmp_path / "electrodes.csv")
    ended = run("heart", "build", mesh_file, "--torso", "none", "--electrodes", electrodes)
    assert ended.status == 0
    assert "heart written to mesh" in ended.out
    assert fascicle.load_heart("mesh").name == "mesh"
    assert (tmp_path / "mesh" / "check.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_the_torso_is_shaped_to_electrodes(run, tmp_path, mesh_file):
    electrodes = anatomies.write_electrodes(tmp_path / "electrodes.csv")
    command = ["heart", "build", mesh_file, "--electrodes", electrodes, "--chest", 95]
    ended = run(*command, "--out", tmp_path / "heart")
    assert ended.status == 0, ended
    assert re.search(r"torso: fitted to the electrodes; height 1\d\d cm, ", ended.out)
    assert "chest 95 cm" in ended.out
    assert "pose: from the electrodes; the apex points " in ended.out
    for name in ELECTRODES:
        assert f"\n{name:<5}" in ended.out
    heart = fascicle.load_heart(tmp_path / "heart")
    whole = np.concatenate([heart.tetrahedra, heart.torso.tetrahedra])
    assert place_electrodes(heart.torso.vertices, whole, heart.electrodes).moved.max() < 2
    np.testing.assert_allclose(heart.electrodes, list(anatomies.PLACES.values()))


def test_found_seeds_lie_on_the_septum_near_the_base(build, mesh_file):
    heart, _ = build(mesh_file)
    for endocardium, towards_other in ((heart.lv, 1), (heart.rv, -1)):
        label = LV if endocardium.side == "lv" else RV
        half_width, _, depth = HALF_AXES[label]
        for vertex, highest, lowest in (
            (endocardium.root, 0.02, 0.3),
            (endocardium.direction, 0.35, 0.6),
        ):
            x, y, z = endocardium.vertices[vertex]
            x += anatomies.BEND[label] * y**2
            assert towards_other * (x - CENTRE_X[label]) > 0.6 * half_width
            assert abs(y) < 12
            assert highest * depth < -z < lowest * depth


def test_given_seeds_are_kept_by_number_and_by_place(build, mesh_file, tmp_path):
    found, _ = build(mesh_file)
    place = found.rv.vertices[17] + [0.3, -0.2, 0.1]
    chosen, _ = build(
        mesh_file,
        *("--lv-root", 11, "--lv-direction", 60),
        *("--rv-root", ",".join(map(str, place)), "--rv-direction", 40),
        out=tmp_path / "chosen",
    )
    assert (chosen.lv.root, chosen.lv.direction) == (11, 60)
    assert (chosen.rv.root, chosen.rv.direction) == (17, 40)
    np.testing.assert_array_equal(chosen.vertices, found.vertices)


def test_angles_are_those_that_were_asked_for(build, mesh_file, tmp_path):
    """Without a helix, fibres lie across the long axis but where the wall itself leans."""
    circular, _ = build(mesh_file, "--lv-angles", "0,0", "--rv-angles", "0,0")
    steep, _ = build(
        mesh_file, "--lv-angles", "80,80", "--rv-angles", "80,80", out=tmp_path / "steep"
    )
    upper = circular.vertices[circular.tetrahedra][:, :, 2].min(axis=1) > -30
    assert np.percentile(np.abs(circular.fibres[upper, 2]), 90) < 0.2
    assert np.median(np.abs(circular.fibres[upper, 2])) < 0.06
    assert np.median(np.abs(steep.fibres[upper, 2])) > 0.9


def test_the_same_command_gives_the_same_files_in_place_of_its_own(build, mesh_file, tmp_path):
    first, again = {}, {}
    for files in (first, again):
        build(mesh_file)
        files |= tree_of(tmp_path / "built")
    assert again.keys() == first.keys() > {"mesh.vtu", "heart.toml", "check.png"}
    for name in first.keys() - {"check.png"}:
        assert again[name] == first[name], name


def tree_of(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_stopped_while_writing_it_leaves_what_was_there(build, run, mesh_file, tmp_path, outside):
    electrodes = anatomies.write_electrodes(tmp_path / "electrodes.csv")
    arguments = ["heart", "build", mesh_file, "--torso", "none", "--electrodes", electrodes]

    def stop(*_):
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fascicle.heart.folder.write_electrodes", stop)
        ended = run(*arguments, "--out", outside / "heart")
    assert ended.status not in (0, 2)
    assert "heart written" not in ended.out
    assert list(outside.iterdir()) == []
    build(mesh_file, out=outside / "heart")
    before = tree_of(outside)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fascicle.heart.folder.write_electrodes", stop)
        assert run(*arguments, "--out", outside / "heart").status not in (0, 2)
    assert tree_of(outside) == before


KILLED = """
import os, signal, sys
import fascicle.heart.folder
from fascicle.cli import main
fascicle.heart.folder.write_electrodes = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
main()
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal on this system")
def test_killed_while_writing_it_leaves_no_half_heart(mesh_file, tmp_path, outside):
    electrodes = anatomies.write_electrodes(tmp_path / "electrodes.csv")
    arguments = ["heart", "build", mesh_file, "--torso", "none", "--electrodes", electrodes]
    command = [sys.executable, "-c", KILLED, *map(str, arguments), "--out", str(outside / "heart")]
    ended = subprocess.run(command, capture_output=True, check=False, env=dict(os.environ))
    assert ended.returncode == -signal.SIGKILL, ended
    assert not (outside / "heart").exists()
    with pytest.raises(fascicle.InputError, match="no such heart folder"):
        fascicle.load_heart(outside / "heart")
