"""Conduction states and fits of people on the atlas, whose hearts are not theirs.

    python -m benchmarks.atlas people [--fits 100] [--out atlas_fits]
    python -m benchmarks.atlas recalibrate

- ``people``: table of aims on 250 recordings of PTB-XL with cardiologists' labels (the even ones
  of the first 500), next to base rates, conventional criteria and the classifier as it is. Paced
  people are left out. The coefficients of the package were learnt on these people, so that the
  figures to go by are the cross-validated ones: five folds, 20 times, coefficients learnt without
  the fold. It prints how many recordings are refused as unlike the simulated ones, of people and
  of mistakes.
  With ``--fits`` so many of them, evenly spread over labels and numbers, are fitted, with what is
  known of the person. A fit is kept in a file of ``--out``, and not made again.
- ``recalibrate``: learn the coefficients with the classifier that is in the package, and write them
  into it. To be run whenever the classifier of the atlas is another one.

Data are read from ``FASCICLE_TEST_DATA``, by default ``../shared/data``.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import log_softmax

import fascicle
from benchmarks.people import auc, label_rows, labelled_targets, labels
from fascicle.core.conduction_states import FASCICULAR_BLOCKS, NORMAL, told_apart
from fascicle.core.errors import InputError
from fascicle.core.leads import INDEPENDENT_LEADS, INDEPENDENT_ROWS, LEADS, limb_leads_from
from fascicle.core.ranges import RANGES
from fascicle.emulation.ecg_classifier import EcgClassifier
from fascicle.emulation.heart_emulator import for_simulations, usual_prior
from fascicle.emulation.recalibration import (
    BUNDLES,
    FASCICLES,
    LEFT_BUNDLE,
    RIGHT_BUNDLE,
    ConditionalLogit,
    Recalibration,
    Term,
    features_of,
    packaged_recalibration,
)
from fascicle.emulation.state_classifier import classifier_of, simulations_of_states
from fascicle.heart.heart import digest_of
from fascicle.recording.target import Target, smooth_noise
from fascicle.study.population import Posterior

Array = NDArray[np.float64]
Codes = set[str]  # of a person's labels
Predictions = Mapping[str, Array]  # probabilities (n,) by name
ANTERIOR, POSTERIOR = FASCICULAR_BLOCKS
CODES = {
    "CLBBB": LEFT_BUNDLE[0], "ILBBB": LEFT_BUNDLE[1], "CRBBB": RIGHT_BUNDLE[0],
    "IRBBB": RIGHT_BUNDLE[1], "IVCD": "intraventricular delay", "LAFB": ANTERIOR, "LPFB": POSTERIOR,
}  # fmt: skip
STATES = (*FASCICLES, *BUNDLES[1:])
FILE = Path(fascicle.__file__).parent / "data" / "recalibration.json"
SEEDS, FOLDS = 20, 5
COMMON = 0.99  # share of people whose recordings count as like the simulated ones


@dataclass(frozen=True)
class Prior:
    """Term of a conditional logit model, with the normal prior of its coefficient."""

    term: Term
    mean: float
    sd: float = 1.0


# QRS durations are in units of 15 ms, evidence in its own (nats): a coefficient of 1 believes it
BUNDLE_PRIORS = (
    Prior(Term("", LEFT_BUNDLE), -4, 2),
    Prior(Term("", LEFT_BUNDLE[1:]), -1.5),
    Prior(Term("", RIGHT_BUNDLE[:1]), -4, 2),
    Prior(Term("", RIGHT_BUNDLE[1:]), -3, 2),
    Prior(Term("", BUNDLES[-1:]), -4, 2),
    Prior(Term("left", LEFT_BUNDLE), 0.5, 0.5),
    Prior(Term("right", RIGHT_BUNDLE), 0.5, 0.5),
    Prior(Term("right block", RIGHT_BUNDLE[:1]), 0.25, 0.5),
    Prior(Term("duration", LEFT_BUNDLE, 120, 15), 0.5),
    Prior(Term("duration", LEFT_BUNDLE[1:], 140, 15), -0.5),
    Prior(Term("duration", RIGHT_BUNDLE[:1], 120, 15), 0.5),
    Prior(Term("duration", BUNDLES[-1:], 120, 15), 0.5),
    Prior(Term("late V1", RIGHT_BUNDLE, 0, 0.15), 0.5),
)
FASCICLE_PRIORS = (
    Prior(Term("", (ANTERIOR,)), -4, 2),
    Prior(Term("", (POSTERIOR,)), -5, 2),
    Prior(Term("superior", (ANTERIOR,), 0, 0.5), 0.5),
    Prior(Term("net II", (ANTERIOR,), 0, 0.5), -0.5),
    Prior(Term("leftward", (POSTERIOR,), 0, 0.5), -1),
)


# --- learning


def fitted(
    states: Sequence[str], priors: Sequence[Prior], features: Predictions, truth: Sequence[str]
) -> ConditionalLogit:
    """Model with the most probable coefficients, given the state of each person."""
    model = ConditionalLogit(tuple(states), tuple(prior.term for prior in priors))
    design, people = model.design(features), np.arange(len(truth))
    labelled = np.array([states.index(state) for state in truth])
    mean, sd = (np.array([getattr(prior, name) for prior in priors]) for name in ("mean", "sd"))

    def loss(coefficients: Array) -> tuple[float, Array]:
        log_p, scores = log_softmax(design @ coefficients, axis=1), (coefficients - mean) / sd
        gradient = np.einsum("ns,nsk->k", np.exp(log_p), design)
        gradient += scores / sd - design[people, labelled].sum(axis=0)
        return 0.5 * (scores**2).sum() - log_p[people, labelled].sum(), gradient

    best = minimize(loss, mean, jac=True, method="L-BFGS-B").x
    pairs = zip(model.terms, best, strict=True)
    return replace(model, terms=tuple(replace(term, coefficient=float(b)) for term, b in pairs))


def learnt(
    features: Predictions, codes: Sequence[Codes], distances: Array, classifier: str = ""
) -> Recalibration:
    """Recalibration learnt from unpaced people, and the distance of all from the simulations.

    Fascicles are learnt where no left bundle branch block is labelled.
    """
    unpaced = np.array(["PACE" not in person for person in codes])
    conducts = unpaced & ~labelled_with(codes, "CLBBB", "ILBBB")

    def model(states: Sequence[str], priors: Sequence[Prior], chosen: Array) -> ConditionalLogit:
        people = [codes[k] for k in np.flatnonzero(chosen).tolist()]
        return fitted(states, priors, of(features, chosen), states_of(people, states))

    return Recalibration(
        model(BUNDLES, BUNDLE_PRIORS, unpaced),
        model(FASCICLES, FASCICLE_PRIORS, conducts),
        float(np.quantile(distances, COMMON)),
        classifier,
    )


def of(features: Predictions, chosen: Array) -> dict[str, Array]:
    """Features or predictions of some of the people."""
    return {name: values[chosen] for name, values in features.items()}


def labelled_with(codes: Sequence[Codes], *names: str) -> NDArray[np.bool_]:
    """Whether each person has one of these labels."""
    return np.array([bool({*names} & person) for person in codes])


def states_of(codes: Sequence[Codes], states: Collection[str] = STATES) -> list[str]:
    """State of each person: of a bundle branch before that of a fascicle, else normal."""
    return [
        next((s for code, s in CODES.items() if code in person and s in states), NORMAL)
        for person in codes
    ]


def written(recalibration: Recalibration) -> str:
    """Text of the file of the package."""
    parts = []
    for name in ("bundles", "fascicles"):
        rows = (
            [t.feature, t.states, t.origin, t.unit, round(t.coefficient, 5)]
            for t in getattr(recalibration, name).terms
        )
        parts.append(f'"{name}": [\n' + ",\n".join(f"  {json.dumps(row)}" for row in rows) + "\n]")
    parts.append(f'"farthest": {recalibration.farthest:.2f}')
    parts.append(f'"classifier": {json.dumps(recalibration.classifier)}')
    return "{\n" + ",\n".join(parts) + "\n}\n"


# --- recordings


@dataclass(frozen=True)
class People:
    """Labelled people: what the classifier of the atlas says of them, and features."""

    rows: Sequence[dict[str, str]]
    targets: Sequence[Target]
    classifier: EcgClassifier
    simulated: Predictions
    features: Predictions

    @classmethod
    def read(cls) -> People:
        """Recordings of all people that can be used, in all twelve leads."""
        classifier = atlas_classifier()
        pairs = [(row, t) for row, t in labelled_targets(label_rows()) if t.used[:12].all()]
        rows, targets = zip(*pairs, strict=True)
        likely = np.array([classifier.probabilities(target) for target in targets])
        named = [dict(zip(BUNDLES, p, strict=True)) for p in likely]
        features = [features_of(t, p) for t, p in zip(targets, named, strict=True)]
        return cls(
            rows, targets, classifier, dict(zip(BUNDLES, likely.T, strict=True)),
            {name: np.array([f[name] for f in features]) for name in features[0]},
        )  # fmt: skip

    @property
    def codes(self) -> list[Codes]:
        """Labels of each person."""
        return [labels(row) for row in self.rows]

    def distances(self, change: Callable[[Target], Target] = lambda target: target) -> Array:
        """Distance of each recording, perhaps changed, from the simulated ones."""
        cosines = (self.classifier.cosines(change(target)) for target in self.targets)
        return self.classifier.distance(np.concatenate([*cosines]))


@cache
def atlas_classifier() -> EcgClassifier:
    """Packaged classifier of the atlas."""
    heart, folder, count, pool = for_simulations("atlas", None, "simulations", None, None)
    model = fascicle.ForwardModel(heart)
    states = simulations_of_states(model, usual_prior(heart), folder, count)
    assert [*states] == [*BUNDLES]
    return classifier_of(states, np.array(INDEPENDENT_ROWS), folder, count, pool)


def digest_of_classifier(classifier: EcgClassifier) -> str:
    """Digest of all arrays of a classifier."""
    arrays = (value for _, value in sorted(classifier.arrays().items()))
    return digest_of(*map(np.asarray, arrays))


def recalibrate() -> None:
    """Write the coefficients that belong to the packaged classifier."""
    people = People.read()
    digest = digest_of_classifier(people.classifier)
    text = written(learnt(people.features, people.codes, people.distances(), digest))
    FILE.write_text(text, encoding="utf-8")
    print(f"{text}of {len(people.rows)} people, written to {FILE}")


# --- cross-validation and metrics

Learner = Callable[[Array, Array], Predictions]  # of people to learn from, and others to predict


def held_out(learn: Learner, truth: Sequence[str], seed: int) -> dict[str, Array]:
    """Predictions of each person by what was learnt from the others' folds."""
    rng, numbers = np.random.default_rng(seed), np.array([STATES.index(s) for s in truth])
    order = rng.permutation(len(truth))
    order = order[np.argsort(numbers[order], kind="stable")]  # a state is in all folds
    fold = np.empty(len(truth), int)
    fold[order] = (np.arange(len(truth)) + rng.integers(FOLDS)) % FOLDS
    predictions: dict[str, Array] = {}
    for k in range(FOLDS):
        for name, p in learn(np.flatnonzero(fold != k), np.flatnonzero(fold == k)).items():
            predictions.setdefault(name, np.empty(len(truth)))[fold == k] = p
    return predictions


def calibration_error(p: Array, truth: Array, bins: int = 10) -> float:
    """Expected calibration error in bins of equal width."""
    gaps = np.bincount(np.minimum((p * bins).astype(int), bins - 1), p - truth, bins)
    return float(np.abs(gaps).sum() / len(p))


def metrics(predictions: Predictions, codes: Sequence[Codes]) -> dict[str, float]:
    """Discrimination, calibration and log scores of unpaced people.

    Predictions are probabilities of `STATES`, and of a fascicular block with or without a right
    bundle branch block ("any ...").
    """
    p = predictions
    normal, block = labelled_with(codes, "NORM"), 1 - p[NORMAL]
    disturbed = labelled_with(codes, *CODES)
    clear = normal | disturbed
    left, right = p[LEFT_BUNDLE[0]] + p[LEFT_BUNDLE[1]], p[RIGHT_BUNDLE[0]] + p[RIGHT_BUNDLE[1]]
    table, truth = np.stack([p[name] for name in STATES], axis=1), states_of(codes)
    likely = table[np.arange(len(truth)), [STATES.index(s) for s in truth]]
    top = table.argmax(axis=1)
    sides = {"left": labelled_with(codes, "CLBBB", "ILBBB")}
    sides["right"] = labelled_with(codes, "CRBBB", "IRBBB")
    return {
        "normal called a block or delay (<= 0.10)": float((top[normal] != 0).mean()),
        "normal told >= 0.9 a block (0)": float((block[normal] >= 0.9).sum()),
        "AUC complete left bundle branch block": auc(
            p[LEFT_BUNDLE[0]], labelled_with(codes, "CLBBB")
        ),
        "AUC complete right bundle branch block": auc(
            p[RIGHT_BUNDLE[0]], labelled_with(codes, "CRBBB")
        ),
        "AUC right, complete or incomplete": auc(right, sides["right"]),
        "AUC left anterior fascicular block": auc(
            p[f"any {ANTERIOR}"], labelled_with(codes, "LAFB")
        ),
        "AUC normal, against all other records": auc(block, ~normal),
        "AUC normal, against conduction labels": auc(block[clear], disturbed[clear]),
        "ECE left (<= 0.05)": calibration_error(left, sides["left"]),
        "ECE right (<= 0.05)": calibration_error(right, sides["right"]),
        "ECE any block (<= 0.05)": calibration_error(block, disturbed),
        "log score of states": float(np.log(np.maximum(likely, 1e-6)).mean()),
        "log score of any block": float(
            np.log(np.maximum(np.where(disturbed, block, 1 - block), 1e-6)).mean()
        ),
    }


def with_any(p: dict[str, Array], total: Mapping[str, Array] | None = None) -> Predictions:
    """Predictions with the totals of fascicular blocks, which else are only their states'."""
    total = total or of_names(p, FASCICULAR_BLOCKS)
    return p | {f"any {name}": total[name] for name in FASCICULAR_BLOCKS}


def of_names(p: Predictions, names: Iterable[str]) -> dict[str, Array]:
    """Predictions of some names."""
    return {name: p[name] for name in names}


def predicted(recalibration: Recalibration, features: Predictions) -> Predictions:
    """Predictions of a recalibration."""
    return with_any(recalibration.probabilities(features), recalibration.fascicular(features))


def by_category(
    category: Array, codes: Sequence[Codes], weight: float, training: Array, test: Array
) -> Predictions:
    """Frequencies of states given a category, in which base rates count as `weight` people."""
    truth = np.array(states_of(codes))

    def given(share: Callable[[Array], float]) -> Array:
        base = share(training)
        in_category = [training[category[training] == c] for c in category[test]]
        return np.array(
            [(len(k) * share(k) + weight * base) / (len(k) + weight) for k in in_category]
        )

    def share_of(wanted: Array) -> Callable[[Array], float]:
        return lambda people: float(wanted[people].mean()) if len(people) else 0.0

    # half a person of each state is added, so that none is impossible
    p = {name: given(share_of(truth == name)) + 0.5 / len(training) for name in STATES}
    total = sum(p.values())
    blocks = {
        name: given(share_of(labelled_with(codes, code)))
        for name, code in ((ANTERIOR, "LAFB"), (POSTERIOR, "LPFB"))
    }
    return with_any({name: values / total for name, values in p.items()}, blocks)


def criteria_met(targets: Sequence[Target]) -> Array:
    """First conventional criterion that each recording meets, a complete block first; 0 if none."""
    # right, left of both sources, incomplete right, fascicular, nonspecific
    order = {0: 1, 2: 2, 6: 2, 7: 2, 1: 3, 3: 4, 4: 5, 5: 6}
    return np.array(
        [
            next((n for k, n in order.items() if target.conventional_criteria[k].met), 0)
            for target in targets
        ]
    )


def raw_predictions(simulated: Predictions, codes: Sequence[Codes]) -> Learner:
    """Classifier with the default priors; fascicular blocks are shares of normal, as labelled."""
    products = {state.name: state.probability * simulated[state.name] for state in told_apart()}
    total = sum(products.values())

    def learn(training: Array, test: Array) -> Predictions:
        p = {name: values[test] / total[test] for name, values in products.items()}
        shares = [labelled_with(codes, code)[training].mean() for code in ("LAFB", "LPFB")]
        not_left = 1 - p[LEFT_BUNDLE[0]] - p[LEFT_BUNDLE[1]]
        split = dict(zip(FASCICULAR_BLOCKS, shares, strict=True))
        states = {name: p[NORMAL] * share for name, share in split.items()}
        states[NORMAL] = p.pop(NORMAL) * (1 - sum(shares))
        return with_any(states | p, {name: not_left * share for name, share in split.items()})

    return learn


def learners(people: People, codes: Sequence[Codes], unpaced: list[int]) -> dict[str, Learner]:
    """Ways to predict the states of unpaced people."""
    features, distances = of(people.features, unpaced), np.zeros(1)
    met = criteria_met([people.targets[k] for k in unpaced])

    def recalibrated(training: Array, test: Array) -> Predictions:
        learnt_here = learnt(of(features, training), [codes[k] for k in training], distances)
        return predicted(learnt_here, of(features, test))

    return {
        "base rates": partial(by_category, np.zeros(len(unpaced), int), codes, 3.0),
        "criteria": partial(by_category, met, codes, 3.0),
        "classifier": raw_predictions(of(people.simulated, unpaced), codes),
        "recalibrated": recalibrated,
        "package": lambda _, test: predicted(packaged_recalibration(), of(features, test)),
    }


def print_states(people: People) -> None:
    """Print the table of aims."""
    unpaced: list[int] = np.flatnonzero(~labelled_with(people.codes, "PACE")).tolist()
    codes = [people.codes[k] for k in unpaced]
    truth, columns = states_of(codes), {}
    for name, learn in learners(people, codes, unpaced).items():
        runs = [metrics(held_out(learn, truth, seed), codes) for seed in range(SEEDS)]
        columns[name] = {key: np.mean([run[key] for run in runs]) for key in runs[0]}
    print(f"{len(people.rows)} recordings, {len(unpaced)} without a pacemaker; "
          f"normal {labelled_with(codes, 'NORM').sum()}, {dict(Counter(truth))}")  # fmt: skip
    print("recalibrated: cross-validated, the figures to go by; package: its coefficients, which")
    print("were learnt on these people; criteria: frequencies given them, cross-validated, too")
    print(f"{'':40}" + "".join(f"{name:>14}" for name in columns))
    for key in next(iter(columns.values())):
        print(f"{key:40}" + "".join(f"{column[key]:14.3f}" for column in columns.values()))
    met = np.array(
        [[bool(c.met) for c in people.targets[k].conventional_criteria] for k in unpaced]
    )
    for name, code, which in (("left", "CLBBB", (2, 6, 7)), ("right", "CRBBB", (0,)),
                              ("left anterior", "LAFB", (3,))):  # fmt: skip
        area = auc(met[:, which].sum(axis=1), labelled_with(codes, code))
        print(f"the criteria alone, number that is met, {name}: AUC {area:.3f}")


# --- recordings that are unlike the simulated ones


def reordered(target: Target, order: Sequence[str], signs: Sequence[int] = (1,) * 12) -> Target:
    """Target whose leads show those of `order`, times `signs`."""
    rows = [LEADS.index(name) for name in order]
    return replace(target, beats=target.beats[:, rows] * np.array(signs)[None, :, None])


def swapped(target: Target, pairs: str) -> Target:
    """Target with chest leads swapped, such as ``"V1 V4"``."""
    order, names = [*LEADS], pairs.split()
    for lead, other in zip(names[::2], names[1::2], strict=True):
        order[LEADS.index(lead)], order[LEADS.index(other)] = other, lead
    return reordered(target, order)


def noise_alone(target: Target) -> Target:
    """Target of smooth noise in all leads, the limb leads as they depend on each other."""
    rng = np.random.default_rng(crc32(target.qrs.tobytes()))  # another of each
    beats = smooth_noise(rng, target.beats.shape[1:], 0.5)
    beats[:6] = limb_leads_from(INDEPENDENT_LEADS)[:, :2] @ beats[:2]
    return replace(target, beats=0 * target.beats + beats)


def stretched(target: Target, factor: float) -> Target:
    """Target whose beats last longer from the QRS onset on."""
    times = target.qrs_onset + (target.time - target.qrs_onset) / factor
    beats = [[np.interp(times, target.time, lead) for lead in beat] for beat in target.beats]
    offset = target.qrs_onset + factor * target.qrs_duration
    return replace(target, beats=np.array(beats), qrs_offset=min(offset, float(target.time[-1])))


MISTAKES: dict[str, Callable[[Target], Target]] = {
    "smooth noise": noise_alone,
    "arms reversed": partial(
        reordered, order=("I", "III", "II", "aVL", "aVR", *LEADS[5:]), signs=(-1, *(1,) * 11)
    ),
    "V1 to V6 in reverse": partial(swapped, pairs="V1 V6 V2 V5 V3 V4"),
    "V1 and V2 swapped": partial(swapped, pairs="V1 V2"),
    "V1 and V4 swapped": partial(swapped, pairs="V1 V4"),
    "V2 and V6 swapped": partial(swapped, pairs="V2 V6"),
    "V3 and V6 swapped": partial(swapped, pairs="V3 V6"),
    "inverted": lambda target: replace(target, beats=-target.beats),
    "twice as long": partial(stretched, factor=2.0),
}


def print_refusals(people: People) -> None:
    """Print how many recordings are refused as unlike the simulated ones."""
    distances, rule = people.distances(), packaged_recalibration().farthest
    rng, refused = np.random.default_rng(0), []
    for _ in range(SEEDS):
        fold = rng.permutation(len(distances)) % FOLDS
        limits = [np.quantile(distances[fold != k], COMMON) for k in range(FOLDS)]
        refused.append((distances > np.array(limits)[fold]).mean())
    print(
        f"people refused: {(distances > rule).mean():.3f}, cross-validated {np.mean(refused):.3f}"
    )
    for k in np.flatnonzero(distances > rule).tolist():
        print(f"  {people.rows[k]['ecg_id']}: {distances[k]:.0f}, {sorted(people.codes[k])}")
    print("mistakes refused (by the share outside the components alone, as on other hearts):")
    classifier = people.classifier
    for name, change in MISTAKES.items():
        cosines = np.concatenate([classifier.cosines(change(t)) for t in people.targets])
        far = (classifier.distance(cosines) > rule).mean()
        outside = (classifier.unexplained(cosines) > classifier.most_unexplained).mean()
        print(f"  {name:24}{far:6.2f} ({outside:.2f})")


# --- fits


def print_fits(people: People, count: int, out: Path) -> None:
    """Fit some people on the atlas, and print how well that goes."""
    out.mkdir(parents=True, exist_ok=True)
    truth = [STATES.index(state) for state in states_of(people.codes)]
    order = sorted(range(len(truth)), key=lambda k: (truth[k], int(people.rows[k]["ecg_id"])))
    chosen = np.array(order)[np.linspace(0, len(order) - 1, count).round().astype(int)]
    results = []
    # shuffled, so that those of an interrupted run are spread as evenly
    for done, k in enumerate(np.random.default_rng(0).permutation(chosen), 1):
        path = out / f"{int(people.rows[k]['ecg_id']):05d}.json"
        if not path.exists():
            text = json.dumps(fit_of(people.rows[k], people.targets[k]), indent=1)
            path.with_suffix(".part").write_text(text, encoding="utf-8")
            path.with_suffix(".part").rename(path)
        results.append(json.loads(path.read_text(encoding="utf-8")))
        print(f"{done}/{count} {path.stem}: {results[-1]['verdict']}", flush=True)
    fits = [result for result in results if "seconds" in result]
    refused = len(results) - len(fits)
    good = [f for f in fits if f["converged"] and f["acceptable"]]
    for name, number in (
        ("converged", sum(f["converged"] for f in fits)),
        ("fit acceptable", sum(f["acceptable"] for f in fits)),
        ("both", len(good)),
        ("could not be fitted", refused),
    ):
        print(f"{name}: {number} of {len(results)} ({number / len(results):.0%})")
    reasons = Counter(reason for f in fits for reason in f["reasons"])
    print("reasons of poor fits: " + ", ".join(f"{r} {n}" for r, n in reasons.most_common()))
    alone = Counter(f["reasons"][0] for f in fits if len(f["reasons"]) == 1)
    print("the only reason: " + ", ".join(f"{r} {n}" for r, n in alone.most_common()))
    unnamed = sum("no conduction state is named" in f["verdict"] for f in fits)
    print(f"no conduction state is named: {unnamed} of {len(fits)}")
    hearts = np.percentile([f["hearts"] for f in fits], (10, 50, 90)) if fits else (0, 0, 0)
    print("effective number of hearts: median {1:.0f} ({0:.0f} to {2:.0f})".format(*hearts))
    times = np.percentile([f["seconds"] for f in fits], (50, 90)) if fits else (0, 0)
    print("seconds of a fit: median {:.0f}, 90 % below {:.0f}".format(*times))


def fit_of(row: Mapping[str, str], target: Target) -> dict[str, object]:
    """Fit of one person on the atlas, with what is known of the person."""
    began = time.perf_counter()
    try:
        with tempfile.TemporaryDirectory() as folder:
            heart = fascicle.load_heart("atlas", **build_of(row))
            study = fascicle.fit(heart, target, Path(folder) / "study", progress=None)
    except InputError as error:
        return {"verdict": f"not fitted: {error}"}
    checks = study.checks
    reasons = [name if name in checks.measured else f"lead {name}" for name in checks.disagreeing]
    if checks.explained < checks.least_explained:
        reasons.append("QRS not explained")
    low, high = checks.gain[1:]
    if not low <= checks.gain[0] <= high:
        reasons.append("gain")
    assert isinstance(study.population, Posterior)
    drawn = study.population.averaged["atlas_heart"].astype(int)
    hearts = 1 / ((np.bincount(drawn) / len(drawn)) ** 2).sum()
    return {
        "seconds": time.perf_counter() - began, "hearts": float(hearts),
        "converged": study.statements.converged,
        "acceptable": checks.acceptable, "reasons": reasons, "verdict": study.verdict,
        "explained": checks.explained, "states": dict(getattr(study.population, "states", {})),
        "labels": sorted(labels(row)), "build": build_of(row),
    }  # fmt: skip


def build_of(row: Mapping[str, str]) -> dict[str, float | str]:
    """Sex, age, height and weight as far as they are known, and an adult's."""
    build: dict[str, float | str] = {"sex": "fm"[row["sex"] == "0"]} if row["sex"] else {}
    for name in ("age", "height", "weight"):
        if row[name] and RANGES[name].low <= float(row[name]) <= RANGES[name].high:
            build[name] = float(row[name])
    return build


def people(fits: int, out: Path) -> None:
    """Print states, refusals and fits of labelled people."""
    read = People.read()
    print_states(read)
    print_refusals(read)
    if fits:
        print_fits(read, fits, out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    of_people = commands.add_parser("people")
    of_people.add_argument("--fits", type=int, default=0)
    of_people.add_argument("--out", type=Path, default=Path("atlas_fits"))
    commands.add_parser("recalibrate")
    options = parser.parse_args()
    if options.command == "recalibrate":
        recalibrate()
    else:
        people(options.fits, options.out)


if __name__ == "__main__":
    main()
