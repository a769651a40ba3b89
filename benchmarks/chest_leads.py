"""Faults that the mean beat shows: chest cables exchanged, a lead upside down, T waves alone.

    python -m benchmarks.chest_leads [--held-out] [--count 300] [--displaced 150]

Recordings are those of `benchmarks.qrs_marks` (QRS complexes of 70 to 200 ms, simulated and of
humps; blocks, pacing, ectopic beats, infarcts; noise, low-passes), whose mean QRS is found as in
every recording. Displaced are QRS complexes of random networks on the packaged heart, intrinsic,
blocked or paced, in a conductor without end: heart moved (8 mm, 8 degrees), every chest electrode
moved along the skin (10 mm to each side), all of them up or down (15 mm); all normally distributed.

Printed are how often the leads as they are raise an alarm, and how often each exchange and each
inversion is found with its remedy (in brackets: with another one). The baseline is the same test
without Dower's matrix: a lead is like its neighbours. T waves alone are the same recordings with
each QRS replaced by a line, and pieces of them from the end of a QRS to the next one; counted are
those that become a target at all.

The constants of `fascicle.recording.quality` were tuned on recordings from `TUNING` on;
`--held-out` takes those from `HELD_OUT` on, which took no part in it.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import fascicle
from benchmarks.qrs_marks import PACED, RATE, Case, case
from fascicle.core.errors import InputError
from fascicle.core.leads import CHEST_LEADS, LEADS
from fascicle.forward.beat import Beat
from fascicle.forward.electrocardiogram import build_electrocardiograph, unbounded_gradients
from fascicle.forward.scenario_files import find_scenario, read_scenario
from fascicle.mesh.measures import barycentric_gradients
from fascicle.recording.quality import CHEST, FASTEST_QRS, check_chest_leads, check_mean_beat
from fascicle.recording.recording import Recording
from fascicle.recording.window import qrs_window

Array = NDArray[np.float64]

TUNING, HELD_OUT = 0, 300_000  # first seeds
KINDS = (
    *5 * ("intrinsic",), "left-anterior-fascicular-block", "left-posterior-fascicular-block",
    *3 * ("left-bundle-branch-block",), *3 * ("right-bundle-branch-block",), "pvc-rv-outflow",
    *2 * ("rv-apical-pacing",), "rv-outflow-pacing", "rv-septal-pacing", "biventricular-pacing",
    "left-bundle-branch-pacing",
)  # fmt: skip
FAULTS = [f"--swap {a}-{b}" for a, b in pairwise(CHEST_LEADS)]
FAULTS += [f"--invert {lead}" for lead in CHEST_LEADS]


def faulty(qrs: Array, remedy: str) -> Array:
    """Leads (12, n) with the fault that a remedy undoes."""
    option, names = remedy.split()
    rows = [LEADS.index(name) for name in names.split("-")]
    changed = qrs.copy()
    changed[rows] = -qrs[rows] if option == "--invert" else qrs[rows[::-1]]
    return changed


@functools.cache
def _model() -> fascicle.ForwardModel:
    return fascicle.ForwardModel(fascicle.load_heart("default"))


def _electrodes(rng: np.random.Generator) -> Array:
    """The nine electrodes relative to a displaced heart, with displaced chest electrodes."""
    heart = _model().heart
    places, middle = heart.electrodes.copy(), heart.vertices.mean(axis=0)
    for place in places[3:]:
        along = np.array([-place[1], place[0], 0.0]) / np.hypot(*place[:2])
        place += rng.normal(0, 10) * along + [0, 0, rng.normal(0, 10)]
    places[3:, 2] += rng.normal(0, 15)
    turn = Rotation.from_rotvec(np.radians(rng.normal(0, 8, 3)))
    return np.asarray(turn.apply(places - middle) + middle + rng.normal(0, 8, 3))


def displaced(seed: int) -> Array:
    """QRS (12, n) of a random network, with heart and electrodes displaced."""
    rng, model = np.random.default_rng([seed, 1]), _model()
    heart = model.heart
    scenario = read_scenario(find_scenario(str(rng.choice(KINDS))))[0]
    outcome = None
    while not isinstance(outcome, Beat):
        parameters = {
            name: value * (1 + 0.08 * rng.standard_normal()) if "length" in name else value
            for name, value in fascicle.EXAMPLE_PARAMETERS.items()
        }
        parameters |= {"root_time": rng.uniform(-40, 30), "cv": rng.uniform(2, 4)}
        outcome = model.simulate(parameters | {"alpha": rng.uniform(0.045, 0.09)}, scenario)
    corners = heart.tetrahedra
    leads = build_electrocardiograph(
        corners,
        barycentric_gradients(heart.vertices, corners),
        heart.volumes,
        model.conduction.intracellular(heart.fibres),
        unbounded_gradients(heart.vertices, corners, _electrodes(rng), 1.0),
        model.action_potential,
    ).leads(outcome.activation)
    # at rest before, as a recording is
    leads = np.concatenate([np.zeros((12, 60)), leads[:12]], axis=1)
    first, last = qrs_window(leads)
    return np.asarray(leads[:, first : last + 1])


def without_qrs(synthetic: Case) -> list[Recording]:
    """T waves alone: a line in place of each QRS, and what is between two of them."""
    rate, signal = synthetic.recording.sampling_rate, synthetic.recording.signal.copy()
    starts, stops = (
        np.round((synthetic.begins + end) * rate / RATE).astype(int)
        for end in (synthetic.onset - 10.0, synthetic.offset + 10.0)
    )
    for start, stop in zip(starts, stops, strict=True):
        if start >= 0 and stop < signal.shape[1]:
            signal[:, start : stop + 1] = np.linspace(
                signal[:, start], signal[:, stop], stop - start + 1, axis=1
            )
    piece = synthetic.recording.signal[:, stops[2] : starts[3]]
    return [replace(synthetic.recording, signal=signal), Recording(piece, rate, "a T wave")]


def recorded(synthetic: Case) -> tuple[str, Array] | None:
    """Group and mean QRS (12, n) of a recording; None where it gives no target."""
    try:
        target = fascicle.make_target(synthetic.recording)
    except InputError:
        return None
    width = "wide" if target.qrs_duration >= 120 else "narrow"
    return "paced" if synthetic.kind in (*PACED, "paced") else width, target.qrs


def by_neighbours(qrs: Array) -> tuple[float, str]:
    """Baseline: figure and remedy by how far each lead is from the line between its neighbours."""

    def roughness(leads: Array) -> float:
        return float(np.square(np.diff(leads[6:], 2, axis=0)).sum())

    remaining = {remedy: roughness(faulty(qrs, remedy)) for remedy in FAULTS}
    best = min(remaining, key=remaining.__getitem__)
    return roughness(qrs) / remaining[best], best


def by_check(qrs: Array) -> tuple[float, str]:
    """Figure of the check and its remedy, which is empty below the limit."""
    check = check_chest_leads(qrs)
    return check.value, check.message.rpartition(": ")[2]


def report(label: str, cases: list[Array], figure: Callable[[Array], tuple[float, str]]) -> None:
    """Print one line: alarms of the leads as they are, and faults found."""
    limit = CHEST.limit
    if figure is by_neighbours:  # as many false alarms as 1 in 100
        limit = float(np.quantile([figure(qrs)[0] for qrs in cases], 0.99))
    false = np.mean([figure(qrs)[0] > limit for qrs in cases])
    cells = []
    for remedy in FAULTS:
        answers = [figure(faulty(qrs, remedy)) for qrs in cases]
        right = np.mean([ratio > limit and name == remedy for ratio, name in answers])
        other = np.mean([ratio > limit and name != remedy for ratio, name in answers])
        cells.append(f"{100 * right:4.0f} ({100 * other:.0f})")
    print(f"{label:<22}{len(cases):>5}{100 * false:7.1f} {''.join(f'{c:>9}' for c in cells)}")


def report_speed(label: str, beats: list[Array]) -> None:
    """Print how many of some beats are slower than any QRS."""
    slow = [not check_mean_beat(qrs)[0].value >= FASTEST_QRS.limit for qrs in beats]
    print(f"{label:<22}{len(beats):>5}, too slow for a QRS: {sum(slow)} ({np.mean(slow):.1%})")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--held-out", action="store_true", help="seeds that tuned nothing")
    parser.add_argument("--count", type=int, default=300, help="recordings (default 300)")
    parser.add_argument("--displaced", type=int, default=150, help="displaced (default 150)")
    arguments = parser.parse_args()
    first = HELD_OUT if arguments.held_out else TUNING
    groups: dict[str, list[Array]] = {"narrow": [], "wide": [], "paced": []}
    t_waves: dict[str, list[Array]] = {"QRS replaced by lines": [], "between two QRS": []}
    for seed in range(first, first + arguments.count):
        synthetic = case(seed)
        group_and_qrs = recorded(synthetic)
        if group_and_qrs is not None:
            groups[group_and_qrs[0]].append(group_and_qrs[1])
        if (group_and_qrs is not None and group_and_qrs[0] == "paced") or seed % 4:
            continue  # spikes are QRS enough; T waves of every fourth are enough
        for label, alone, noise in zip(t_waves, without_qrs(synthetic), (None, 0.03), strict=True):
            with contextlib.suppress(InputError):
                t_waves[label].append(fascicle.make_target(alone, noise=noise).qrs)
    complexes = [qrs for group in groups.values() for qrs in group]
    groups["displaced"] = [displaced(seed) for seed in range(first, first + arguments.displaced)]
    names = "".join(f"{remedy.split()[1]:>9}" for remedy in FAULTS)
    print(f"{'found, %':<22}{'n':>5}{'false':>7} {names}   (V1 ...: upside down)")
    for label, cases in groups.items():
        report(label, cases, by_check)
    report("all", [*complexes, *groups["displaced"]], by_check)
    report("all, by neighbours", [*complexes, *groups["displaced"]], by_neighbours)
    report_speed("QRS", complexes)
    for label, beats in t_waves.items():
        report_speed(label, beats)


if __name__ == "__main__":
    main()
