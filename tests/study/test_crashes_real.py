"""A fit with the forward model, killed at random moments, comes to the same result."""

import json
import time

import numpy as np
import pytest
import xarray as xr

import fascicle
from benchmarks.fits import demo_recording
from fascicle.study.fitted import load_study
from tests.study.crashing import killed_at_random

PAPER = {
    "method": "paper", "initial": 12, "steps": 4, "samples": 5, "draws": 20_000, "tolerance": 1.0,
}  # fmt: skip
POSTERIOR = {"prior_simulations": 100, "effective": 20}
KILLS = 5


def rows(folder):
    """Evaluations in order, all but how long they took."""
    found = [(r.stage, r.evaluation) for r in load_study(folder).study.records()]
    return [
        (stage, each.point.tobytes(), each.loss, each.beat_errors.tobytes())
        for stage, each in found
        if each.feasible
    ]


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
        files = [p.relative_to(whole) for p in sorted(whole.rglob("*")) if p.is_file()]
        there = [p.relative_to(folder) for p in sorted(folder.rglob("*")) if p.is_file()]
        assert there == files
        for name in ("networks/best/parameters.toml", "target.nc", "heart/heart.toml"):
            assert (folder / name).read_bytes() == (whole / name).read_bytes()
        assert json.loads((folder / "summary.json").read_text()) == json.loads(
            (whole / "summary.json").read_text()
        )
        assert np.isfinite(load_study(folder).population.best_loss)
