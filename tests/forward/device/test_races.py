"""No kernel reads or writes where it must not, and none of what another thread is writing."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from emulated import drawn

from fascicle.forward.preparation import as_arrays

HERE = Path(__file__).resolve().parent

SANITISERS = {
    "asan": ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"),
    "tsan": ("-O1", "-g", "-fsanitize=thread", "-DTHREADS=4"),
}


@pytest.fixture(scope="module")
def written(default_model, tmp_path_factory):
    """A model, two networks, and their activation."""
    folder = tmp_path_factory.mktemp("model")
    arrays = as_arrays(default_model.prepared, default_model.heart)
    np.savez(folder / "model.npz", **arrays)
    networks = drawn(2)
    np.savez(
        folder / "networks.npz",
        names=[*networks[0]],
        values=[[*network.values()] for network in networks],
        activation=[default_model.simulate(network).activation for network in networks],
    )
    return folder / "model.npz", folder / "networks.npz"


def run_under(sanitiser, written):
    """Run the networks in a process into which the sanitiser is loaded first."""
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("no C++ compiler (g++)")
    found = subprocess.run(
        [compiler, f"-print-file-name=lib{sanitiser}.so"], capture_output=True, text=True
    ).stdout.strip()
    if not Path(found).is_absolute():
        pytest.skip(f"no lib{sanitiser}")
    paths = os.pathsep.join([str(HERE.parents[1]), *sys.path])  # what the tests import
    options = {"ASAN_OPTIONS": "detect_leaks=0", "TSAN_OPTIONS": "halt_on_error=1:exitcode=66"}
    return subprocess.run(
        [sys.executable, HERE / "sanitised.py", *written, *SANITISERS[sanitiser]],
        env={**os.environ, **options, "LD_PRELOAD": found, "PYTHONPATH": paths},
        capture_output=True, text=True,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("sanitiser", SANITISERS)
def test_under_a_sanitiser(sanitiser, written):
    """Addresses and overflow; threads that run at the same time."""
    ended = run_under(sanitiser, written)
    if "unexpected memory mapping" in ended.stderr:
        pytest.skip(f"{sanitiser} does not run on this kernel")
    assert ended.returncode == 0, ended.stderr[-3000:]
    assert "Sanitizer" not in ended.stderr
