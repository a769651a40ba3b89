"""The program as a program: help, imports, exit statuses."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import pyvista

from fascicle.build.segmentation_files import read_segmentation
from fascicle.core.errors import InputError
from fascicle.heart.folder import load_heart, write_heart
from fascicle.mesh.read import read_mesh
from fascicle.networks.settings import FitSettings

PROGRAM = Path(sys.executable).with_name("fascicle")
HEAVY = ("vtkmodules", "pyvista", "matplotlib", "arviz", "numba", "scipy", "meshio")


def test_importing_the_command_line_loads_nothing_heavy():
    check = f"import sys, fascicle.cli.commands; print(*[m for m in {HEAVY} if m in sys.modules])"
    ended = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout.strip(), ended.stderr) == (0, "", "")


def test_installed_program():
    ended = subprocess.run([PROGRAM, "--help"], capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (0, "")
    for command in ("heart", "simulate", "target", "fit", "predict", "report", "demo"):
        assert f" {command} " in ended.stdout


def test_every_setting_of_a_fit_is_an_option(run, monkeypatch):
    """With the default of the Python function, and given to it as it stands."""
    seen = []

    def fit(heart, target, out, parameters, progress, pool, **settings):
        assert (parameters, pool) == ({}, None)
        seen.append(FitSettings(**settings))
        raise InputError("stop here")

    monkeypatch.setattr("fascicle.fit", fit)
    run("fit", "default", "t.nc", "--out", "s")
    changed = {
        "initial": 7, "steps": 0, "samples": 2, "seed": 3, "workers": 4, "draws": 50,
        "tolerance": 0.5, "refit_every": 5, "refit_after": 6, "rounds": 8, "method": "paper",
        "leads": "8", "fewest_junctions": 10,
        "prior_simulations": 100, "effective": 30, "gain_sd": 0.1,
    }  # fmt: skip
    options = [f"--{name.replace('_', '-')}={value}" for name, value in changed.items()]
    run("fit", "default", "t.nc", "--out", "s", "--gain", *options)
    assert seen == [FitSettings(), FitSettings(free_gain=True, **changed)]
    with pytest.raises(InputError, match="'fix' is no setting of a fit"):
        FitSettings(fix={"conduction": "normal"})
    assert set(changed) | {"free_gain"} == set(FitSettings.model_fields)


def test_unknown_options_and_commands(run):
    for arguments in (["simulat"], ["simulate", "default", "--ot", "x"], ["simulate"]):
        ended = run(*arguments)
        assert ended.status == 2
        assert "Traceback" not in ended.err
        assert "Usage" in ended.err


def test_errors_of_the_real_program(materials, outside):
    spoilt = materials.folder / "cut.vtu"
    spoilt.write_bytes(materials.files["mesh"].read_bytes()[:-3000])
    command = materials.command(outside / "heart", mesh=spoilt)  # of which VTK complains, too
    ended = subprocess.run(
        [sys.executable, "-m", "fascicle.cli", *map(str, command)], capture_output=True, text=True
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.startswith("error: ")
    assert ended.stderr.count("\n") == 1
    assert list(outside.iterdir()) == []


def test_names_that_no_file_system_takes(refused, outside):
    name = "x" * 300
    refused(["simulate", "default", "--params", f"{name}.toml", "--out", outside / "s"], name)
    assert list(outside.iterdir()) == []


def test_without_the_extra_build(monkeypatch, tmp_path, refused, run):
    """Hearts are read, checked and written; what takes VTK or reads label maps names the extra."""
    (label_map := tmp_path / "labels.nii").write_bytes(bytes(400))
    pyvista.Sphere().save(surface := tmp_path / "heart.vtp")
    digest = load_heart("camps-dti004").digest
    for module in ("pyvista", "vtkmodules", "nibabel", "nrrd"):
        monkeypatch.setitem(sys.modules, module, None)
    extra = "install it: pip install 'fascicle-ecg[build]'\n"
    refused(["heart", "build", surface, "--out", tmp_path / "new"], "building a heart", extra)
    for call, needed in ((read_mesh, surface), (read_segmentation, label_map)):
        with pytest.raises(InputError, match=re.escape(extra.strip())) as error:
            call(needed)
        assert str(error.value).startswith(str(needed))
    write_heart(load_heart("camps-dti004"), tmp_path / "heart")
    assert load_heart(tmp_path / "heart").digest == digest
    assert (
        run("heart", "check", tmp_path / "heart", "--picture", tmp_path / "heart.png").status == 0
    )
