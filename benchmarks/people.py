"""Priors, model and conduction states on people and two dogs whose answer is known.

    python -m benchmarks.people [prior] [ecgs] [blocks] [subject] [dogs] [ptbxl] [criteria]
                                [--half check]

Without names, all of these:

- ``prior``: networks of the prior of the normal state on both packaged hearts: how many activate
  the left septum first, and how many lie within all ranges of mapped human hearts.
- ``ecgs``: ECGs of these in random torsos: net deflection (R − S)/(R + S) of V1 and V2, and the
  transition. Of the normal recordings of PTB-XL these are −0.65, −0.43 and V3 to V4.
- ``blocks``: one network with and without each block: change of the frontal axis, and share of the
  energy of the QRS that changes.
- ``subject``: the ECG of the subject of ``camps-dti004`` on the heart of that subject, with
  Purkinje fibres up to the base, as they are, and up to three quarters of the way from the apex.
- ``dogs``: two dogs on their own hearts, before and after ablation of the left bundle branch
  (Oomen et al., Biomech. Model. Mechanobiol. 2021, doi:10.1007/s10237-021-01532-7): how probable
  each state is with priors of dogs (`canine_priors`) and of people, and the fitted speed along
  fibres. Of each dog 16,000 networks of the normal state are simulated with priors of dogs, and
  8000 of each other, an hour in all.
- ``ptbxl``: recordings of PTB-XL with cardiologists' labels, on the packaged hearts, which are
  somebody else's: how many get a state named, how many normal ones a block, and the area under the
  ROC curve (AUC) of the side of a bundle branch block by what the classifier says all the same.
- ``criteria``: the conventional criteria that recordings of PTB-XL meet, by their labels.

The priors of `rv_source` and `axial_source` were chosen by the normal recordings of the half
``tune`` (half of their number odd); ``check`` took no part in anything. Data are read from
``FASCICLE_TEST_DATA``, by default ``../shared/data``.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

import fascicle
from fascicle.build.build_heart import TorsoOptions, build_heart
from fascicle.build.read_anatomy import Source
from fascicle.cli.output import TerminalProgress
from fascicle.core.conduction_states import CONDUCTION_STATES
from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.core.parameters import HUMAN_SPACE
from fascicle.emulation.heart_emulator import usual_prior
from fascicle.emulation.state_classifier import NoStateNamed
from fascicle.forward.beat import Beat
from fascicle.forward.loss import align
from fascicle.heart.atlas import with_bare_base
from fascicle.heart.folder import write_heart
from fascicle.networks.prior_simulations import random_bodies
from fascicle.recording.criteria import frontal_axis
from fascicle.recording.pipeline import Analysis
from fascicle.recording.target import Target

Array = NDArray[np.float64]
HEARTS = ("camps-dti004", "default")
DATA = Path(os.environ.get("FASCICLE_TEST_DATA", "../shared/data"))
PTBXL = DATA / "ecg" / "ptbxl"
NETWORKS = 600  # that are drawn
TORSOS = 12
# The slow onset of the QRS of dog007 is lost in power-line interference and baseline wander.
DOGS: dict[str, dict[str, float]] = {"dog006": {}, "dog007": {"notch": 60.0, "onset": -20.0}}
DOG_NETWORKS = 16_000  # of the normal state; half as many of each other
# Conduction velocities (m/s) of canine Purkinje fibres: 1.62 in 12 preparations (Myerburg et al.,
# Circ. Res. 42 (1978) 27-35), stretched 2.32 +- 0.45 (Rosen et al., Am. J. Physiol. 240 (1981)
# H546-H554). The conduction velocity of the muscle along the fibre has the range of people.
CANINE_CV = (1.5, 2.8)
BUNDLE_BRANCH = {"left": ("CLBBB", "ILBBB"), "right": ("CRBBB", "IRBBB")}


def normal_networks(
    model: fascicle.ForwardModel, count: int, seed: int
) -> Iterator[tuple[dict[str, float], Beat]]:
    """Networks of the prior of the normal state, with their beats."""
    prior = usual_prior(model.heart, CONDUCTION_STATES["normal"])
    points = prior.sample(np.random.default_rng(seed), count)
    points[:, -1] = np.sort(points[:, -1])  # a tissue takes seconds to prepare
    for point in points:
        values = prior.from_unit(point)
        beat = model.simulate(values)
        if isinstance(beat, Beat) and prior.keeps(point, model.surfaces, beat):
            yield values, beat


def net_deflections(qrs: Array) -> Array:
    """(R − S)/(R + S) of each lead of a QRS (12, n)."""
    high, low = np.maximum(qrs.max(axis=1), 0), np.maximum(-qrs.min(axis=1), 0)
    return np.asarray((high - low) / (high + low + 1e-9))


def transition(net: Array) -> int:
    """Number of the first chest lead that is net positive, 7 if none is."""
    positive = np.flatnonzero(net[LEADS.index("V1") :] > 0)
    return int(positive[0]) + 1 if len(positive) else 7


def prior() -> None:
    """Print how often the prior of the normal state is activated as mapped hearts are."""
    for name in HEARTS:
        model = fascicle.ForwardModel(name)
        sequences = [
            model.surfaces.sequence(beat.activation)
            for _, beat in normal_networks(model, NETWORKS, 1)
        ]
        first = np.mean([s.first == "left septum" for s in sequences])
        left = np.mean([s.first.startswith("left") for s in sequences])
        mapped = np.mean([s.is_mapped for s in sequences])
        print(f"{name}: {len(sequences)} of {NETWORKS} draws are of the prior")
        print(f"  left ventricle first {left:.0%}, left septum {first:.0%}; mapped {mapped:.0%}")
        for interval in ("rv_delay", "rv_breakthrough", "lv_breakthrough", "total"):
            low, middle, high = np.percentile(
                [getattr(s, interval) for s in sequences], (5, 50, 95)
            )
            print(f"  {interval}: {middle:.0f} ms ({low:.0f} to {high:.0f})")


def ecgs() -> None:
    """Print V1, V2 and the transition of simulated normal ECGs in random torsos."""
    for name in HEARTS:
        model, rng = fascicle.ForwardModel(name), np.random.default_rng(2)
        torsos = random_bodies(model, rng, TORSOS)
        features = []
        for values, beat in normal_networks(model, NETWORKS, 2):
            torso = model.with_sources(torsos[rng.integers(TORSOS)], values)
            leads = torso.leads(beat.activation)
            net = net_deflections(leads)
            axis = frontal_axis(leads)
            features.append([net[LEADS.index("V1")], net[LEADS.index("V2")], transition(net), axis])
        v1, v2, at, axis = np.median(features, axis=0)
        print(f"{name}: net V1 {v1:+.2f}, V2 {v2:+.2f}, transition V{at:.0f}, axis {axis:.0f}°")


def blocks() -> None:
    """Print what each block changes in the same networks."""
    for name in HEARTS:
        model = fascicle.ForwardModel(name)
        networks = [*normal_networks(model, 240, 3)][:60]
        for state in [*CONDUCTION_STATES.values()][1:]:
            turned, changed = [], []
            for values, beat in networks:
                late = {
                    name: (low + high) / 2
                    for name, (low, high) in state.ranges.items()
                    if name in values and not low <= values[name] <= high
                }
                other = model.simulate(values | late | state.blocks)
                if not isinstance(other, Beat):
                    continue
                alignment = align(other.leads, beat.leads, free_gain=True)
                changed.append(alignment.loss * beat.leads.shape[1] / (beat.leads**2).sum())
                turn = frontal_axis(other.leads) - frontal_axis(beat.leads)
                turned.append((turn + 180) % 360 - 180)
            axis, energy = np.median(turned), np.median(changed)
            print(f"{name}: {state.name}: axis {axis:+.0f}°, energy {energy:.0%}")


def subject() -> None:
    """Print fits of the subject's ECG on the subject's heart."""
    options = fascicle.TargetOptions(noise=0.03)
    analysis = fascicle.analyse(fascicle.read_recording(HEARTS[0]), options)
    heart = fascicle.load_heart(HEARTS[0])
    for height in (1.0, 0.75):
        print(f"Purkinje fibres of the free walls up to {height:.0%} of the height")
        print_subject(with_bare_base(heart, height), analysis)


def print_subject(heart: fascicle.Heart, analysis: Analysis) -> None:
    """Print the fit on a heart, by an emulator of its own."""
    with tempfile.TemporaryDirectory() as folder:
        fitted = fascicle.fit(
            heart, analysis.target, folder, parameters={"conduction": "normal"},
            prior_simulations=8000,
        )  # fmt: skip
        networks = fitted.networks()
        summary = json.loads((Path(folder) / "summary.json").read_text(encoding="utf-8"))
    print(fitted.verdict)
    print("\n".join(f"  {line}" for line in fitted.statements.sequence))
    print(f"  log evidence of two runs {summary['log_evidences']}")
    print(f"  QRS duration (ms) {summary['qrs_duration_ms']}")
    recorded, window = analysis.target.mean, analysis.target.qrs_samples
    mean = np.mean([network.predicted for network in networks], axis=0)
    unexplained = ((mean - recorded)[:, window] ** 2).sum() / (recorded[:, window] ** 2).sum()
    alike = {
        lead: np.corrcoef(mean[k, window], recorded[k, window])[0, 1]
        for k, lead in enumerate(LEADS)
    }
    print(f"  the mean explains {1 - unexplained:.0%}; r of each lead:")
    print("  " + ", ".join(f"{lead} {r:.2f}" for lead, r in alike.items()))


def canine_priors(heart: fascicle.Heart) -> dict[str, dict[str, float]]:
    """Parameters of a fit of a dog: lengths of people scaled with its endocardia, and speeds."""
    person = fascicle.load_heart(HEARTS[0])
    ranges = {"cv": CANINE_CV}
    for canine, human in zip(heart.endocardia, person.endocardia, strict=True):
        scale = (canine.area / human.area) ** 0.5
        for p in HUMAN_SPACE.parameters:
            if p.name.startswith(canine.side) and "length" in p.name:
                ranges[p.name] = scale * p.lower, scale * p.upper
    return {name: {"lower": low, "upper": high} for name, (low, high) in ranges.items()}


def dogs() -> None:
    """Print how probable each state is before and after ablation of the left bundle branch."""
    for name, options in DOGS.items():
        files = DATA / "hearts" / name
        source = Source(file=files / "mesh_hexahedra.vtu")
        torso = TorsoOptions(electrodes=files / "electrodes.csv")
        with tempfile.TemporaryDirectory() as folder, TerminalProgress() as progress:
            built = build_heart(source, edge_length=3.0, torso=torso, name=name, progress=progress)
            heart = Path(folder) / name
            write_heart(built.heart, heart)
            priors = canine_priors(built.heart)
            for when, state in (("baseline", "normal"), ("lbbb", "left bundle branch block")):
                recording = fascicle.read_recording(files / f"ecg_{when}.csv")
                target = fascicle.make_target(recording, **options)
                print(f"{name}, {when}: QRS {target.qrs_duration:.0f} ms")
                for of, learnt, count in (("dogs", priors, DOG_NETWORKS), ("people", {}, None)):
                    answer = fascicle.state_probabilities(
                        heart, target, parameters=learnt, prior_simulations=count,
                        progress=progress,
                    )  # fmt: skip
                    why = f" ({answer.reason})" if isinstance(answer, NoStateNamed) else ""
                    named = ", ".join(f"{state} {p:.2f}" for state, p in likely(answer).items())
                    print(f"  with priors of {of}{why}: {named}")
                study = fascicle.fit(
                    heart, target, Path(folder) / when, parameters={**priors, "conduction": state},
                    prior_simulations=DOG_NETWORKS, effective=100, progress=progress,
                )  # fmt: skip
                speeds = np.percentile(study.population.values["fibre_speed"], (50, 5, 95))
                print(f"  {study.verdict}")
                print("  speed along fibres {:.2f} m/s ({:.2f} to {:.2f})".format(*speeds))


def ptbxl(half: str) -> None:
    """Print the states of labelled people on hearts that are not theirs."""
    rows = [row for row in label_rows() if is_of(half, row)]
    targets = [(labels(row), target) for row, target in labelled_targets(rows)]
    print(f"{len(targets)} of {len(rows)} recordings ({half})")
    for name in HEARTS:
        answers = [
            (codes, fascicle.state_probabilities(name, target, progress=None))
            for codes, target in targets
        ]
        named = [(c, a) for c, a in answers if not isinstance(a, NoStateNamed)]
        normal = [(c, a) for c, a in named if "NORM" in c]
        blocked = sum(max(a, key=a.__getitem__) != next(iter(a)) for _, a in normal)
        print(f"{name}: a state is named of {len(named)} of {len(answers)}")
        print(f"  of {len(normal)} normal recordings with a state {blocked} are called a block")
        for code in (code for codes in BUNDLE_BRANCH.values() for code in codes):
            called = Counter(max(a, key=a.__getitem__) for c, a in named if code in c)
            print(f"  {code}: {dict(called)}")
        sides = [
            (codes, {side: of_side(answer, side) for side in BUNDLE_BRANCH})
            for codes, answer in answers
        ]
        for side, branch_codes in BUNDLE_BRANCH.items():
            labelled = np.array([bool({*branch_codes} & codes) for codes, _ in sides])
            scores = np.array([probabilities[side] for _, probabilities in sides])
            complete = np.array([branch_codes[0] in codes for codes, _ in sides])
            whole = auc(scores[complete | ~labelled], complete[complete | ~labelled])
            print(
                f"  {side} bundle branch, complete or incomplete: AUC {auc(scores, labelled):.2f} "
                f"({labelled.sum()}), complete: {whole:.2f} ({complete.sum()})"
            )


def label_rows() -> list[dict[str, str]]:
    """Rows of the table of the recordings of PTB-XL."""
    with (PTBXL / "labels.csv").open(encoding="utf-8") as file:
        return [*csv.DictReader(file)]


def labelled_targets(rows: Iterable[dict[str, str]]) -> Iterator[tuple[dict[str, str], Target]]:
    """Rows with the targets of their recordings; those that cannot be used are printed."""
    for row in rows:
        try:
            recording = fascicle.read_recording(PTBXL / f"{int(row['ecg_id']):05d}_hr.hea")
            yield row, fascicle.make_target(recording)
        except InputError as error:
            print(f"  {row['ecg_id']}: {error}")


def is_of(half: str, row: dict[str, str]) -> bool:
    """Whether a recording is of the half ``tune`` or ``check``."""
    return (int(row["ecg_id"]) // 2 % 2 == 1) == (half == "tune")


def labels(row: dict[str, str]) -> set[str]:
    """Codes that the cardiologists gave a recording."""
    return {*re.findall(r"'(\w+)'", row["scp_codes"])}


def criteria() -> None:
    """Print which conventional criteria recordings of PTB-XL meet, by label."""
    conduction = {*BUNDLE_BRANCH["left"], *BUNDLE_BRANCH["right"], "LAFB", "LPFB", "IVCD", "WPW"}
    met: dict[str, list[set[str]]] = {"normal": [], "CLBBB": [], "CRBBB": [], "LAFB": []}
    durations = []
    for row, target in labelled_targets(label_rows()):
        codes = labels(row)
        names = {criterion.name for criterion in target.conventional_criteria if criterion.met}
        if "NORM" in codes:
            durations.append(target.qrs_duration)
            if not codes & conduction:
                met["normal"].append(names)
        for code in codes & {*met}:
            met[code].append(names)
    low, middle, high = np.percentile(durations, (5, 50, 95))
    print(f"QRS of {len(durations)} normal ones: {middle:.0f} ms (90 % {low:.0f} to {high:.0f})")
    for label, of_label in met.items():
        counts = Counter(name for names in of_label for name in names)
        listed = ", ".join(f"{name} {count}" for name, count in counts.most_common())
        any_met = sum(bool(names) for names in of_label)
        print(f"  {label}: {any_met} of {len(of_label)} meet one ({listed})")


def likely(answer: Mapping[str, float] | NoStateNamed) -> Mapping[str, float]:
    """Probability of each state, also where none is named."""
    return answer.unreliable if isinstance(answer, NoStateNamed) else answer


def of_side(answer: Mapping[str, float] | NoStateNamed, side: str) -> float:
    """Probability that the bundle branch of a side is blocked or slow."""
    states = likely(answer)
    return float(sum(states[name] for name in states if name.startswith(f"{side} bundle branch")))


def auc(scores: Array, positive: NDArray[np.bool_]) -> float:
    """Area under the ROC curve."""
    ranks, count = rankdata(scores), positive.sum()
    above = ranks[positive].sum() - count * (count + 1) / 2
    return float(above / max(count * (len(positive) - count), 1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts: dict[str, Callable[[], None]] = {
        "prior": prior, "ecgs": ecgs, "blocks": blocks, "subject": subject, "dogs": dogs,
        "criteria": criteria,
    }  # fmt: skip
    parser.add_argument("parts", nargs="*", choices=[*parts, "ptbxl", []], metavar="PART")
    parser.add_argument("--half", choices=("tune", "check"), default="check")
    arguments = parser.parse_args()
    parts["ptbxl"] = lambda: ptbxl(arguments.half)
    for name in arguments.parts or parts:
        print(f"== {name}")
        parts[name]()


if __name__ == "__main__":
    main()
