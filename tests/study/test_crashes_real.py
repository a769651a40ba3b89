"""A fit with the forward model, killed at random moments, comes to the same result."""

import time

import numpy as np
import pytest
import xarray as xr

import fascicle
from benchmarks.fits import demo_recording
from fascicle.core.files import DISPOSABLE
from fascicle.study.fitted import load_study
from tests.study.crashing import killed_at_random

PAPER = {
    "method": "paper", "initial": 12, "steps": 4, "samples": 5, "draws": 20_000, "tolerance": 1.0,
}  # fmt: skip
POSTERIOR = {"prior_simulations": 100, "effective": 20}
KILLS = 5


def rows(folder):
    """Evaluations in order, all but how long they took."""
    records = [(r.stage, r.evaluation) for r in load_study(folder).study.records()]
    return [
        (stage, evaluation.point.tobytes(), evaluation.loss, evaluation.beat_errors.tobytes())
        for stage, evaluation in records
        if evaluation.feasible
    ]


def files(folder):
    """Files of a study, without what other studies of the heart have cached meanwhile."""
    paths = [p.relative_to(folder) for p in sorted(folder.rglob("*")) if p.is_file()]
    return [p for p in paths if p.parts[:2] != ("heart", DISPOSABLE)]


@pytest.mark.slow
@pytest.mark.usefixtures("plain_tissue")
@pytest.mark.parametrize(
    ("budget", "result"), [(PAPER, "population.nc"), (POSTERIOR, "posterior.nc")]
)
def test_kill_at_random_moments(tmp_path, budget, result):
    target = fascicle.make_target(fascicle.read_recording(demo_recording()))

    def work(folder):
        fascicle.fit("default", target, folder, **budget)

    whole = tmp_path / "whole"
    work(whole)
    begin = time.perf_counter()
    work(tmp_path / "timed")  # with all compiled and prepared
    longest = time.perf_counter() - begin
    finished = killed_at_random(work, tmp_path, KILLS, longest, seed=1)
    for folder in finished:
        assert rows(folder) == rows(whole)
        for group in ("posterior", "posterior_predictive", "sample_stats"):
            with (
                xr.open_dataset(folder / result, group=group, engine="h5netcdf") as found,
                xr.open_dataset(whole / result, group=group, engine="h5netcdf") as wanted,
            ):
                assert found.equals(wanted)
        assert files(folder) == files(whole)
        names = "networks/best/parameters.toml", "target.nc", "heart/heart.toml", "summary.json"
        for name in names:
            assert (folder / name).read_bytes() == (whole / name).read_bytes()
        assert np.isfinite(load_study(folder).population.best_loss)
