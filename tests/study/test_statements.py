"""What a result says of itself."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from fascicle.core.conduction_states import FASCICULAR_BLOCKS, NORMAL
from fascicle.core.leads import LEADS
from fascicle.core.parameters import NETWORK_SPACE
from fascicle.emulation.predictive import Checks
from fascicle.heart.conduction import Conduction
from fascicle.inference.evaluation import Evaluation
from fascicle.networks.prior import Prior
from fascicle.recording.criteria import Criterion
from fascicle.study.evaluations import Stage
from fascicle.study.fitted import FittedStudy
from fascicle.study.population import Population, Posterior
from fascicle.study.statements import HEART_MEASURES, Kind, Statements

LEFT_BLOCK, RIGHT_BLOCK = "left bundle branch block", "right bundle branch block"
MIDDLE = NETWORK_SPACE.from_unit(np.full(len(NETWORK_SPACE), 0.5))


def fitted(
    *, loss=0.5, best=None, regions=None, values=None, fixed=None, junctions=(200, 300), under=0.99,
    lead_fields=True, gain=1.0, upside_down=None, method="paper", networks=30, beats=300,
    candidates=(), learnt=None, share=None, mapped=False, met=(),
):  # fmt: skip
    """A study of which only what decides the warnings is there."""
    regions = None if regions is None else np.array(regions)
    heart = SimpleNamespace(regions=regions, has_torso=lead_fields, atlas=None, no_image="")
    conduction = Conduction().with_values(values or {})
    model = SimpleNamespace(heart=heart, conduction=conduction)
    trees = [
        SimpleNamespace(side=side, junctions=np.arange(count))
        for side, count in zip(("lv", "rv"), junctions, strict=True)
    ]
    recorded = np.sin(np.linspace(0, 6, 40)) * np.arange(1, 13)[:, None]
    predicted = np.pad(recorded, ((0, 0), (2, 8)))
    if upside_down is not None:
        predicted[upside_down] *= -1
    tried = [SimpleNamespace(evaluation=e, stage=Stage.REJECTION) for e in candidates]
    target = SimpleNamespace(
        earliest_onset=None, leads=LEADS, qrs=recorded, qrs_samples=slice(2, 42),
        beats=np.empty(beats),
        conventional_criteria=[
            Criterion(name, name in met, "", "Strauss 2011") for name in (LEFT_BLOCK, RIGHT_BLOCK)
        ],
    )  # fmt: skip
    all_but_v6 = np.arange(12) != 11
    recording = SimpleNamespace(null_loss=2.0, scenario=None, target=target, compared=all_but_v6)
    config = SimpleNamespace(method=method, samples=30, effective=60)
    study = FittedStudy(
        SimpleNamespace(config=config, records=lambda: tried),
        SimpleNamespace(model=model, prior=Prior(NETWORK_SPACE, fixed or {}, mapped=mapped)),
        (recording,),
        Population(learnt or {}, np.ones(networks), MIDDLE | (best or {}), loss),
        None if share is None else Checks(share, {}),
    )
    simulation = SimpleNamespace(trees=trees)
    study.__dict__["best_network"] = SimpleNamespace(
        beat=simulation, under_qrs=under, gain=gain, predicted=predicted, parameters={}
    )
    return study


POSTERIOR = {"method": "posterior"}
CV = NETWORK_SPACE.parameters[NETWORK_SPACE.names.index("cv")]
RNG = np.random.default_rng(0)
# Of 30 networks 15 within the highest tenth of the speed, or a third of its whole range
CROWDED = CV.from_unit(np.array([*RNG.uniform(0.9, 1, 15), *RNG.random(15) * 0.8]))
SPREAD = CV.from_unit(RNG.random(30))
TRIED = [Evaluation(np.zeros(2), loss, np.ones(3)) for loss in (0.4, 0.5, 0.6)]
TRIED.append(Evaluation.infeasible(np.zeros(2), "left the endocardium"))


@pytest.mark.parametrize(
    ("given", "kind", "words"),
    [
        ({"loss": 1.2}, Kind.POOR_FIT, "explains 40% of the recorded QRS"),
        ({"loss": 2.5}, Kind.POOR_FIT, "explains 0% of the recorded QRS"),
        # the best network may explain half: that many others do not is what counts
        (POSTERIOR | {"share": 0.6}, Kind.POOR_FIT, "none of the sampled networks reproduces the"),
        (
            {"learnt": {"cv": CROWDED}},
            Kind.END_OF_RANGE,
            "many networks lie at an end of the range of Purkinje conduction velocity (50% ",
        ),
        (
            {"best": {"cv": 3.999, "root_time": -75.0}},
            Kind.END_OF_RANGE,
            "range of delay between the roots, Purkinje conduction velocity:",
        ),
        # V2, and V6, which is not compared
        ({"upside_down": [7, 11]}, Kind.LEADS, "does not explain V2 (-1.00):"),
        (
            {"mapped": True, "met": [LEFT_BLOCK]},
            Kind.CONDUCTION,
            f"fixed at normal, but the recording meets the criteria of {LEFT_BLOCK} (Strauss 2011)",
        ),
        ({"gain": 0.4}, Kind.GAIN, "scaled by 0.4"),
        ({"gain": 2.5}, Kind.GAIN, "scaled by 2.5"),
        ({"networks": 12}, Kind.FEW_NETWORKS, "12 of 30 networks were accepted of 0 candidates"),
        ({"beats": 29}, Kind.FEW_BEATS, "29 beats"),
        ({"candidates": TRIED}, Kind.NOT_THE_MINIMUM, "1 of 4 candidates match better"),
        ({"regions": [0, 1, 1, 5]}, Kind.REGIONS, "regions 1, 5 of the heart count as healthy"),
        ({"lead_fields": False}, Kind.NO_TORSO, "the heart has no torso"),
        ({"junctions": (200, 12)}, Kind.FEW_JUNCTIONS, "200 (LV), 12 (RV) junctions"),
        ({"under": 0.4}, Kind.OUTSIDE_QRS, "only 40% of the best network's ECG"),
    ],
)
def test_warnings(given, kind, words):
    (warning,) = fitted(**given).statements.warnings
    assert warning.kind == kind
    assert words in warning.text


@pytest.mark.parametrize(
    "given",
    [
        {}, POSTERIOR | {"share": 0.9}, {"learnt": {"cv": SPREAD}}, {"best": {"cv": 3.9}},
        {"mapped": True}, {"met": [LEFT_BLOCK]},
        {"gain": 1.9}, POSTERIOR | {"networks": 12}, {"beats": 30}, POSTERIOR | {"beats": 1},
        {"regions": [0, 1], "values": {"region_1_conductivity": 0.0}},
        {"regions": [0, 1], "fixed": {"region_1_conductivity": 0.2}},
    ],
)  # fmt: skip
def test_no_warnings(given):
    assert fitted(**given).warnings == []


def test_networks_are_called_what_they_are():
    assert fitted().explained == pytest.approx(0.75)
    assert fitted().verdict == "30 networks, a population and not a posterior"
    own = "30 networks of your own, which were not compared with the ECG"
    assert fitted(method="posterior").verdict == own


# --- hearts of an atlas

COUNT = 40
MEASURES = {name: np.linspace(50, 150, COUNT) for name in HEART_MEASURES}


def on_atlas(hearts, *, converged=True, states=None, share=0.4):
    """A posterior of equally probable hearts; few of the networks explain the recording."""
    atlas = SimpleNamespace(measures=MEASURES, weights=np.full(COUNT, 1 / COUNT))
    ones = np.ones(len(hearts))
    population = Posterior(
        {"cv": ones}, ones, {}, 0.1, ones[:, None], ones, ones, ones, {}, converged,
        averaged={"atlas_heart": np.asarray(hearts, float)}, states=states or {},
    )  # fmt: skip
    return Statements(
        SimpleNamespace(
            population=population,
            simulator=SimpleNamespace(
                model=SimpleNamespace(heart=SimpleNamespace(atlas=atlas)),
                prior=Prior(NETWORK_SPACE),
            ),
            checks=Checks(share, {}),
        )
    )


def test_hearts_that_the_ecg_tells_apart_are_told_so():
    volume = on_atlas([4, 5, 5, 6], share=0.9).hearts[0]
    assert (volume.name, volume.unit) == HEART_MEASURES["lv_volume"]
    assert volume.constrained
    assert re.search(r"; before the ECG 5\d\.\d–14\d\.\d\)$", str(volume))
    poor = on_atlas([4, 5, 5, 6]).hearts[0]
    assert not poor.constrained
    assert str(poor).endswith("), poor fit")
    assert volume.median == pytest.approx(MEASURES["lv_volume"][5])
    assert not on_atlas(range(COUNT), share=0.9).hearts[0].constrained
    assert on_atlas([4, 5], converged=False).hearts == ()


def test_states_calibrated_on_people_are_named_although_the_fit_is_poor():
    states = {NORMAL: 0.7, "left bundle branch block": 0.3}
    on_people = states | dict.fromkeys(FASCICULAR_BLOCKS, 0.0)
    assert on_atlas([1, 2], states=states).states == ""
    assert on_atlas([1, 2], states=on_people).states.startswith("normal: 0.70, left bundle")
