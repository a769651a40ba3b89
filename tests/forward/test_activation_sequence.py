"""Where and when the ventricles are activated, of activations whose sequence is known."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.emulation.predictive import DURATION, Checks
from fascicle.forward.activation_sequence import (
    MAPPED,
    PARTS,
    ActivationSequence,
    SequenceSummary,
    VentricularSurfaces,
)
from fascicle.heart.sites import RIGHT, SEGMENTS, Sites

# ms; first of each part, in a mapped heart, and the end
MAPPED_TIMES = {
    "lv_septum": 0.0, "lv_free_wall": 4.0, "rv_septum": 8.0, "rv_free_wall": 15.0,
    "rv_breakthrough": 20.0, "lv_breakthrough": 33.0,
}  # fmt: skip
END = 75.0
MAPPED_BEAT = ActivationSequence(**MAPPED_TIMES, total=END, last="basal lateral left ventricle")


@pytest.fixture(scope="module")
def surfaces(default_heart):
    return VentricularSurfaces.of(default_heart)


def activated(heart, surfaces, beginning=40.0, **times):
    """An activation (ms) whose parts are first activated at these times after a beginning."""
    after = np.full(len(heart.vertices), 60.0)
    for name, time in (MAPPED_TIMES | times).items():
        after[surfaces.parts[name]] = 60.0
        after[surfaces.parts[name][7]] = time
    return beginning + after


def test_parts_share_the_surface(default_heart, surfaces):
    """Each vertex of an endocardium is septal or of the free wall; none is of the epicardium."""
    counts = np.zeros(len(default_heart.vertices), dtype=int)
    for own in surfaces.parts.values():
        assert len(own) > 300
        counts[own] += 1
    assert counts.max() == 1
    for endocardium in default_heart.endocardia:
        used = np.unique(endocardium.triangles)
        own = [surfaces.parts[f"{endocardium.side}_{wall}"] for wall in ("septum", "free_wall")]
        assert sum(map(len, own)) == len(used)
        for name in own:
            away = np.linalg.norm(
                default_heart.vertices[name][:, None] - endocardium.vertices[used], axis=2
            )
            assert away.min(axis=1).max() < 1e-6


def nearest(vertices, place):
    return int(np.linalg.norm(vertices - place, axis=1).argmin())


def test_parts_and_places_are_those_of_ventricular_coordinates(default_heart, surfaces):
    """Which are found in another way: by the segments of the coordinates, and named sites."""
    sites, vertices = Sites(default_heart), default_heart.vertices
    for name, part in (
        ("mid anteroseptal endocardium", "lv_septum"),
        ("mid inferoseptal endocardium", "lv_septum"),
        ("mid anterolateral endocardium", "lv_free_wall"),
        ("mid inferolateral endocardium", "lv_free_wall"),
        ("mid anterolateral epicardium", "lv_breakthrough"),
        ("rv free wall", "rv_free_wall"),
        ("rv outflow tract", "rv_free_wall"),
    ):
        place = np.array(sites.position(name))
        away = {
            other: np.linalg.norm(vertices[own] - place, axis=1).min()
            for other, own in surfaces.parts.items()
        }
        assert min(away, key=away.__getitem__) == part
    right = sites.places.segment == RIGHT
    assert (surfaces.rv_wall & right).sum() / (surfaces.rv_wall | right).sum() > 0.85
    walls = {"sept": "septal", "lateral": "lateral", "anterior": "anterior", "": "posterior"}
    for name in SEGMENTS[:-1]:  # all but the apex
        place = np.array(sites.position(f"{name} endocardium"))
        third, wall = name.split()
        expected = next(words for part, words in walls.items() if part in wall)
        assert surfaces.places[nearest(vertices, place)] == f"{third} {expected} left ventricle"
    apex = np.array(sites.position("rv apex"))
    assert surfaces.places[nearest(vertices, apex)] == "apical right ventricle"


def test_first_times_of_parts_are_read_from_an_activation(default_heart, surfaces):
    activation = activated(default_heart, surfaces)
    latest, never = surfaces.parts["lv_breakthrough"][[100, 200]]
    activation[latest], activation[never] = 40.0 + END, np.inf  # a scar is never activated
    found = surfaces.sequence(activation)
    assert {name: getattr(found, name) for name in MAPPED_TIMES} == MAPPED_TIMES
    assert found.total == END
    assert found.last == surfaces.places[latest]
    assert found.rv_delay == 8.0
    assert found.first == "left septum"
    assert found.is_mapped
    early = activated(default_heart, surfaces, rv_free_wall=0.0, lv_septum=9.0, lv_free_wall=12.0)
    found = surfaces.sequence(early)
    assert (found.first, found.rv_delay) == ("right free wall", -9.0)
    assert not found.is_mapped


def test_a_heart_is_seen_as_it_is_activated(default_model):
    """Of a root that is 60 ms late, and of one that is early."""
    for root_time, first in ((-60.0, "right"), (60.0, "left")):
        beat = default_model.simulate(EXAMPLE_PARAMETERS | {"root_time": root_time})
        found = default_model.surfaces.sequence(beat.activation)
        assert found.first.startswith(first)
        assert (found.rv_delay > 0) == (first == "left")
        assert not found.is_mapped
        assert found.total == pytest.approx(beat.total_activation_time)


@pytest.mark.parametrize(
    ("changed", "mapped"),
    [
        ({}, True),
        ({"lv_septum": 1.0, "lv_free_wall": 0.0}, True),
        ({"lv_septum": 1.1, "lv_free_wall": 0.0}, False),
        ({"rv_septum": 3.0}, True),
        ({"rv_septum": 2.9}, False),
        ({"rv_septum": 40.0, "rv_free_wall": 12.0}, True),
        ({"rv_septum": 40.0, "rv_free_wall": 12.1}, False),
        ({"rv_breakthrough": 6.9}, False),
        ({"rv_breakthrough": 25.1}, False),
        ({"lv_breakthrough": 5.0}, True),  # not held against anything
        ({"total": 59.0}, False),
        ({"total": 101.0}, False),
    ],
)
def test_what_is_mapped(changed, mapped):
    assert replace(MAPPED_BEAT, **changed).is_mapped == mapped


LATE_RIGHT = replace(MAPPED_BEAT, rv_septum=30.0, rv_free_wall=35.0)
RIGHT_FIRST = replace(MAPPED_BEAT, rv_free_wall=0.0, lv_septum=8.0, lv_free_wall=9.0)


@pytest.mark.parametrize(
    ("sequences", "words"),
    [
        ([MAPPED_BEAT], ""),
        ([MAPPED_BEAT, LATE_RIGHT], ""),  # half of them
        (
            [MAPPED_BEAT, LATE_RIGHT, LATE_RIGHT],
            "right endocardium after the left one at 30 ms, 3 to 12 ms in mapped hearts",
        ),
        ([RIGHT_FIRST, RIGHT_FIRST, MAPPED_BEAT], "activation begins on the right free wall"),
        (
            [replace(MAPPED_BEAT, total=130.0)],
            "last activation at 130 ms, 60 to 100 ms in mapped hearts",
        ),
        (  # each time is that of a mapped heart in most of them, but never all together
            [
                LATE_RIGHT, replace(MAPPED_BEAT, total=130.0),
                replace(MAPPED_BEAT, rv_breakthrough=40.0),
            ],
            "the sequence of activation is that of a mapped heart in less than half of them",
        ),
    ],
)  # fmt: skip
def test_how_networks_depart_from_mapped_hearts(sequences, words):
    assert SequenceSummary.of(sequences).departure == words


def test_what_several_networks_have_in_common():
    late = [replace(MAPPED_BEAT, total=60.0 + k, last="mid right ventricle") for k in range(21)]
    found = SequenceSummary.of([*late, *[RIGHT_FIRST] * 9])
    assert found.first == {"left septum": 0.7, "right free wall": 0.3}
    assert [*found.last] == ["mid right ventricle", "basal lateral left ventricle"]
    assert found.mapped == 0.7
    assert found.times.keys() == MAPPED.keys()
    totals = [60.0 + k for k in range(21)] + [END] * 9
    assert found.times["total"] == pytest.approx(np.percentile(totals, (50, 5, 95)))
    first, last, *times = found.lines
    assert first == "first activated: left septum 70%, right free wall 30%"
    assert last.startswith("last activated: mid right ventricle 70%, ")
    assert times[1] == (
        "right endocardium after the left one: 8 ms (90 % CrI -8 to 8; normally 3 to 12)"
    )
    assert len(times) == len(MAPPED)
    assert {*found.first} <= {*PARTS.values()}


def test_checks_keep_the_sequence_in_json():
    summary = SequenceSummary.of([MAPPED_BEAT, LATE_RIGHT, LATE_RIGHT])
    checks = Checks(0.9, {"V1": 0.4}, {DURATION: [90.0, 80.0, 88.0, 95.0]}, sequence=summary)
    again = Checks.from_json(json.dumps(asdict(checks)))
    assert isinstance(again.sequence, SequenceSummary)
    assert again.sequence.lines == summary.lines
    assert again.unmapped == checks.unmapped != ""
    assert json.dumps(asdict(again)) == json.dumps(asdict(checks))
    without = Checks(0.9, {"V1": 0.4})
    assert Checks.from_json(json.dumps(asdict(without))) == without


@pytest.mark.parametrize(
    ("measured", "said"),
    [
        ({DURATION: [90.0, 80.0, 88.0, 95.0]}, True),
        ({DURATION: [119.0, 80.0, 88.0, 95.0]}, True),
        ({DURATION: [120.0, 80.0, 88.0, 95.0]}, False),
        ({f"{DURATION} of recording 1": [90.0, 80.0, 88.0, 95.0]}, True),
        ({}, False),  # nobody knows which hearts to compare it with
    ],
)
def test_a_long_qrs_is_not_held_against_mapped_hearts(measured, said):
    checks = Checks(0.9, {}, measured, sequence=SequenceSummary.of([RIGHT_FIRST]))
    words = "activation begins on the right free wall: not seen in mapped hearts with this QRS"
    assert checks.unmapped == (words if said else "")
    assert replace(checks, sequence=SequenceSummary.of([MAPPED_BEAT])).unmapped == ""
    joined = Checks.joined([replace(checks, sequence=None), checks])
    assert joined.sequence is checks.sequence
