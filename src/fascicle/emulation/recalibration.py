"""Recalibration of the atlas's conduction states on people with cardiologists' labels.

The classifier of the atlas learns from simulations, in which fascicular blocks are not told apart
from normal. Two conditional logit models make probabilities of the states that cardiologists name:
one of the bundle branches, from the evidence of the classifier, the QRS duration and the end of V1;
one of the fascicles, from the frontal axis and lead II. In each, the score of state s is a sum of
terms β (x − origin)/unit that count for s, and P(s) = exp(score) / Σ exp(score). Their product is
the whole: P(normal) = P(bundle branches normal) P(fascicles normal).

The coefficients β were learnt from the even ones of the first 500 records of PTB-XL (P. Wagner et
al., "PTB-XL, a large publicly available electrocardiography dataset", Sci. Data 7, 2020;
CC BY 4.0): 245 people without a pacemaker, 144 with the label normal, 4 with a left bundle branch
block and 1 with an incomplete one, 4 with a right one and 12 with an incomplete one, 16 with a left
anterior and 3 with a left posterior fascicular block, 2 with an intraventricular delay. So few
states need few coefficients, whose priors point the way that textbooks do; terms are smooth and,
but for the QRS duration, bounded. ``python -m benchmarks.atlas recalibrate`` learns them again.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.special import softmax

from fascicle.core.arrays import Floats
from fascicle.core.conduction_states import FASCICULAR_BLOCKS, NORMAL
from fascicle.core.leads import LEADS
from fascicle.heart.heart import Heart
from fascicle.recording.criteria import frontal_axis
from fascicle.recording.target import Target

Features = Mapping[str, Any]  # arrays (n,), or numbers of one recording
LEFT_BUNDLE = "left bundle branch block", "left bundle branch delay"
RIGHT_BUNDLE = "right bundle branch block", "right bundle branch delay"
BUNDLES = (NORMAL, *LEFT_BUNDLE, *RIGHT_BUNDLE, "intraventricular delay")
FASCICLES = (NORMAL, *FASCICULAR_BLOCKS)


@dataclass(frozen=True)
class Term:
    """Term of scores: a feature from an `origin` in a `unit`; the constant 1 if it has no name."""

    feature: str
    states: tuple[str, ...]  # for which it counts
    origin: float = 0.0
    unit: float = 1.0
    coefficient: float = 0.0


@dataclass(frozen=True)
class ConditionalLogit:
    """Conditional logit model of states, the first of which has the score 0."""

    states: tuple[str, ...]
    terms: tuple[Term, ...]

    def design(self, features: Features) -> Floats:
        """Values (n, states, terms) that the coefficients multiply."""
        count = np.size(next(iter(features.values())))
        design = np.zeros((count, len(self.states), len(self.terms)))
        for k, term in enumerate(self.terms):
            x: Any = 1.0
            if term.feature:
                x = (np.asarray(features[term.feature]) - term.origin) / term.unit
            for state in term.states:
                design[:, self.states.index(state), k] = x
        return design

    def probabilities(self, features: Features) -> dict[str, Floats]:
        """Probability (n,) of each state."""
        scores = self.design(features) @ [term.coefficient for term in self.terms]
        return dict(zip(self.states, softmax(scores, axis=1).T, strict=True))


@dataclass(frozen=True)
class Recalibration:
    """Models of bundle branches and fascicles, and the distance of people from the simulations.

    Attributes
    ----------
    bundles, fascicles : ConditionalLogit
        Models of `BUNDLES` and `FASCICLES`.
    farthest : float
        Distance (`EcgClassifier.distance`) that 99 % of these people do not exceed.
    classifier : str
        Digest of the classifier to which the coefficients belong.
    """

    bundles: ConditionalLogit
    fascicles: ConditionalLogit
    farthest: float
    classifier: str

    def probabilities(self, features: Features) -> dict[str, Floats]:
        """Probability (n,) of each state; they exclude each other and add up to 1.

        A fascicular block with a block or delay of the right bundle branch is of the latter's
        state.
        """
        bundles = self.bundles.probabilities(features)
        normal = bundles.pop(NORMAL)
        fascicles = self.fascicles.probabilities(features)
        return {name: normal * p for name, p in fascicles.items()} | bundles

    def fascicular(self, features: Features) -> dict[str, Floats]:
        """Probability (n,) of each fascicular block, alone or with a right bundle branch block."""
        bundles = self.bundles.probabilities(features)
        left_conducts = 1 - sum(bundles[name] for name in LEFT_BUNDLE)
        fascicles = self.fascicles.probabilities(features)
        return {name: left_conducts * fascicles[name] for name in FASCICULAR_BLOCKS}


@cache
def packaged_recalibration() -> Recalibration:
    """Recalibration of the packaged classifier of the atlas."""
    text = (files("fascicle") / "data" / "recalibration.json").read_text(encoding="utf-8")
    content = json.loads(text)
    bundles, fascicles = (
        ConditionalLogit(
            states, tuple(Term(t[0], tuple(t[1]), *map(float, t[2:])) for t in content[name])
        )
        for name, states in (("bundles", BUNDLES), ("fascicles", FASCICLES))
    )
    return Recalibration(bundles, fascicles, content["farthest"], content["classifier"])


def recalibration_of(heart: Heart, target: Target, states: Collection[str]) -> Recalibration | None:
    """Recalibration of a classifier of simulated `states`; None if there is none.

    There is one of the atlas, whose classifier has learnt from many hearts, by all twelve leads.
    """
    of_people = heart.atlas is not None and {*states} == {*BUNDLES}
    return packaged_recalibration() if of_people and target.used[: len(LEADS)].all() else None


def features_of(target: Target, simulated: Mapping[str, float]) -> dict[str, float]:
    """Features of a recording in all twelve leads.

    `simulated` are probabilities of `BUNDLES` by a classifier of simulations, of equal priors.
    """
    return evidence(simulated) | measurements(target.qrs[: len(LEADS)])


def evidence(simulated: Mapping[str, float], floor: float = 0.003) -> dict[str, float]:
    """Log odds of groups of states against normal, bounded by a least probability."""

    def against_normal(*states: str) -> float:
        p = sum(simulated[name] for name in states)
        return float(np.log((p + floor) / (simulated[NORMAL] + floor)))

    return {
        "left": against_normal(*LEFT_BUNDLE),
        "right": against_normal(*RIGHT_BUNDLE),
        "right block": against_normal(RIGHT_BUNDLE[0]),
    }


def measurements(qrs: Floats) -> dict[str, float]:
    """Measurements of the QRS (12, n) of a mean beat (mV), every 1 ms."""
    axis = np.radians(frontal_axis(qrs))
    ii, v1 = qrs[LEADS.index("II")], qrs[LEADS.index("V1")]
    high, low = max(ii.max(), 0.0), max(-ii.min(), 0.0)
    return {
        "duration": qrs.shape[1] - 1.0,
        "superior": float(-np.sin(axis)),
        "leftward": float(np.cos(axis)),
        "net II": float((high - low) / (high + low + 1e-9)),
        "late V1": float(v1[-40:].sum() / (np.abs(v1).sum() + 1e-9)),  # its last 40 ms
    }


def simulated_state(name: str) -> str:
    """State whose simulations stand for a state: normal for the fascicular blocks."""
    return NORMAL if name in FASCICULAR_BLOCKS else name


def as_simulated(probable: Mapping[str, float]) -> dict[str, float]:
    """Probabilities of states, added up over those that have the same simulations."""
    sums: dict[str, float] = {}
    for name, p in probable.items():
        sums[simulated_state(name)] = sums.get(simulated_state(name), 0.0) + p
    return sums
