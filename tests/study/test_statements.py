"""What a result says of itself."""

from types import SimpleNamespace

import numpy as np
import pytest

from fascicle.core.leads import LEADS
from fascicle.core.parameters import NETWORK_SPACE
from fascicle.emulation.predictive import Checks
from fascicle.heart.conduction import Conduction
from fascicle.inference.evaluation import Evaluation
from fascicle.networks.prior import Prior
from fascicle.study.evaluations import Stage
from fascicle.study.fitted import FittedStudy
from fascicle.study.population import Population
from fascicle.study.statements import Kind

MIDDLE = NETWORK_SPACE.from_unit(np.full(len(NETWORK_SPACE), 0.5))


def fitted(
    *,
    loss=0.5,
    best=None,
    regions=None,
    values=None,
    fixed=None,
    junctions=(200, 300),
    under=0.99,
    lead_fields=True,
    gain=1.0,
    upside_down=None,
    method="paper",
    networks=30,
    beats=300,
    candidates=(),
    learnt=None,
    share=None,
):
    """A study of which only what decides the warnings is there."""
    heart = SimpleNamespace(
        regions=None if regions is None else np.array(regions),
        has_torso=lead_fields,
    )  # fmt: skip
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
    study = FittedStudy(
        SimpleNamespace(
            config=SimpleNamespace(method=method, samples=30, effective=60), records=lambda: tried
        ),
        SimpleNamespace(model=model, prior=Prior(NETWORK_SPACE, fixed or {})),
        (
            SimpleNamespace(
                null_loss=2.0,
                scenario=None,
                target=SimpleNamespace(
                    earliest_onset=None,
                    leads=LEADS,
                    qrs=recorded,
                    qrs_samples=slice(2, 42),
                    beats=np.empty(beats),
                ),
                compared=np.arange(12) != 11,  # all but V6
            ),
        ),
        Population(learnt or {}, np.ones(networks), MIDDLE | (best or {}), loss),
        None if share is None else Checks(share, {}),
    )
    simulation = SimpleNamespace(trees=trees)
    study.__dict__["best_network"] = SimpleNamespace(
        beat=simulation, under_qrs=under, gain=gain, predicted=predicted, parameters={}
    )
    return study


def kinds(study):
    return [warning.kind for warning in study.statements.warnings]


def test_a_good_fit_has_none():
    assert fitted().warnings == []
    assert fitted().explained == pytest.approx(0.75)


@pytest.mark.parametrize(("loss", "share"), [(1.2, "40%"), (2.5, "0%")])
def test_what_the_model_does_not_explain(loss, share):
    (warning,) = fitted(loss=loss).warnings
    assert f"explains {share} of the recorded QRS" in warning


def test_what_no_network_of_a_posterior_explains():
    """The best network may explain half: that many others do not is what counts."""
    (warning,) = fitted(method="posterior", share=0.6).warnings
    assert warning.startswith("none of the sampled networks reproduces the recorded QRS")
    assert fitted(method="posterior", share=0.9).warnings == []


def test_networks_that_crowd_at_an_end():
    """Of 30 networks 15 within the highest tenth of the speed; a third of the others' range."""
    rng = np.random.default_rng(0)
    cv = NETWORK_SPACE.parameters[NETWORK_SPACE.names.index("cv")]
    values = np.array([cv.from_unit(s) for s in [*rng.uniform(0.9, 1, 15), *rng.random(15) * 0.8]])
    (warning,) = fitted(learnt={"cv": values}).warnings
    assert warning.startswith(
        "networks crowd at an end of the range of Purkinje conduction velocity (50% "
    )
    spread = np.array([cv.from_unit(s) for s in rng.random(30)])
    assert fitted(learnt={"cv": spread}).warnings == []


def test_leads_of_another_shape():
    (warning,) = fitted(upside_down=[7, 11]).warnings  # V2, and V6, which is not compared
    assert "does not explain V2 (-1.00):" in warning


@pytest.mark.parametrize("gain", [0.4, 2.5])
def test_a_gain_far_from_one(gain):
    assert kinds(fitted(gain=gain)) == [Kind.GAIN]
    assert fitted(gain=1.9).warnings == []


def test_fewer_networks_than_wanted():
    (warning,) = fitted(networks=12).warnings
    assert warning.startswith("12 of 30 networks were accepted of 0 candidates")
    assert fitted(networks=12, method="posterior").warnings == []


def test_few_beats():
    assert kinds(fitted(beats=29)) == [Kind.FEW_BEATS]
    assert fitted(beats=30).warnings == fitted(beats=1, method="posterior").warnings == []


def test_candidates_that_are_better_than_the_best():
    tried = [Evaluation(np.zeros(2), loss, np.ones(3)) for loss in (0.4, 0.5, 0.6)]
    tried.append(Evaluation.infeasible(np.zeros(2), "left the endocardium"))
    (warning,) = fitted(candidates=tried).warnings
    assert warning.startswith("1 of 4 candidates match better")


def test_networks_are_called_what_they_are():
    assert fitted().verdict == "30 networks, a population and not a posterior"
    own = "30 networks of your own, which were not compared with the ECG"
    assert fitted(method="posterior").verdict == own


def test_regions_that_count_as_healthy():
    (warning,) = fitted(regions=[0, 1, 1, 5]).warnings
    assert warning.startswith("regions 1, 5 of the heart count as healthy")
    assert fitted(regions=[0, 1], values={"region_1_conductivity": 0.0}).warnings == []
    assert fitted(regions=[0, 1], fixed={"region_1_conductivity": 0.2}).warnings == []


@pytest.mark.parametrize(
    ("given", "kind"),
    [
        ({"lead_fields": False}, Kind.NO_TORSO),
        ({"junctions": (200, 12)}, Kind.FEW_JUNCTIONS),
        ({"under": 0.4}, Kind.OUTSIDE_QRS),
    ],
)
def test_other_warnings(given, kind):
    assert kinds(fitted(**given)) == [kind]


def test_a_value_at_the_end_of_its_range():
    (warning,) = fitted(best={"cv": 3.999, "root_time": -75.0}).warnings
    assert "range of RV–LV activation delay, Purkinje conduction velocity:" in warning
    assert fitted(best={"cv": 3.9}).warnings == []
