"""Two small targets of the packaged heart, and tables that name them."""

import numpy as np
import pytest

from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.recording.target import Target
from fascicle.recording.target_files import write_target

SMALL = {
    "method": "paper", "initial": "6", "steps": "0", "samples": "2", "draws": "20", "rounds": "2",
    "tolerance": "1",
}  # fmt: skip
NOISE = 0.3  # mV; so much that any network will do


@pytest.fixture(scope="session")
def targets(default_model, tmp_path_factory):
    """Folder with two targets and a file that is none."""
    folder = tmp_path_factory.mktemp("targets")
    ecg = default_model.simulate(EXAMPLE_PARAMETERS).leads
    beat = np.pad(ecg, ((0, 0), (40, 40)))
    time = np.arange(beat.shape[1]) - 60.0
    for number, name in enumerate(("anna", "carl")):
        noise = np.random.default_rng(number).normal(size=(5, *beat.shape))
        write_target(Target(beat + NOISE * noise, time, -20.0, 40.0, 60.0), folder / f"{name}.nc")
    (folder / "bert.nc").write_text("nothing")
    return folder


@pytest.fixture
def table(targets, tmp_path):
    """Write a table of patients whose recordings are the targets of their names."""

    def write(*patients, name="patients.csv", **settings):
        settings = settings if "method" in settings else SMALL | settings
        columns = ["patient", "heart", "recording", *settings]
        rows = [[p, "default", targets / f"{p}.nc", *settings.values()] for p in patients]
        path = tmp_path / name
        path.write_text("\n".join(",".join(map(str, row)) for row in [columns, *rows]) + "\n")
        return path

    return write
