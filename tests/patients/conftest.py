"""Two small targets of small ventricles, and tables that name them."""

import anatomies
import numpy as np
import pytest

from fascicle.forward.model import ForwardModel
from fascicle.heart.folder import load_heart
from fascicle.recording.target import Target
from fascicle.recording.target_files import write_target

SMALL = {
    "method": "paper", "initial": "6", "steps": "0", "samples": "2", "draws": "20", "rounds": "2",
    "tolerance": "1",
}  # fmt: skip
NOISE = 0.3  # mV; so much that any network will do


@pytest.fixture(scope="session")
def targets(ventricles, tmp_path_factory):
    """Folder with two targets, a file that is none, and a prior of networks that fit in."""
    folder = tmp_path_factory.mktemp("targets")
    ecg = ForwardModel(load_heart(ventricles)).simulate(anatomies.NETWORK).leads
    beat = np.pad(ecg, ((0, 0), (40, 40)))
    time = np.arange(beat.shape[1]) - 60.0
    for number, name in enumerate(("anna", "carl")):
        noise = np.random.default_rng(number).normal(size=(5, *beat.shape))
        write_target(Target(beat + NOISE * noise, time, -20.0, 40.0, 60.0), folder / f"{name}.nc")
    (folder / "bert.nc").write_text("nothing")
    ranges = [
        f"{name} = {{ lower = {0.8 * value}, upper = {1.2 * value} }}"
        for name, value in anatomies.NETWORK.items()
        if "length" in name
    ]
    (folder / "small.toml").write_text("\n".join(["[parameters]", *ranges]) + "\n")
    return folder


@pytest.fixture
def table(targets, ventricles, tmp_path):
    """Write a table of patients whose recordings are the targets of their names."""

    def write(*patients, name="patients.csv", heart=ventricles, **settings):
        if "method" not in settings:
            settings = SMALL | {"settings": targets / "small.toml"} | settings
        columns = ["patient", "heart", "recording", *settings]
        rows = [[p, heart, targets / f"{p}.nc", *settings.values()] for p in patients]
        path = tmp_path / name
        path.write_text("\n".join(",".join(map(str, row)) for row in [columns, *rows]) + "\n")
        return path

    return write
