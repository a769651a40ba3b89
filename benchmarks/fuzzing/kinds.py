"""Kinds of files that are damaged, and the functions that read them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.fuzzing import seeds
from benchmarks.fuzzing.seeds import Seed

if TYPE_CHECKING:
    from fascicle.forward.model import ForwardModel


@dataclass(frozen=True)
class Kind:
    """Files of one kind.

    Attributes
    ----------
    seeds : function
        Makes undamaged files.
    read : function
        Reads a path; any exception but InputError is a failure.
    """

    seeds: Callable[[], list[Seed]]
    read: Callable[[Path], Any]


def _mesh(path: Path) -> Any:
    from fascicle.mesh.read import read_mesh

    return read_mesh(path)


def _segmentation(path: Path) -> Any:
    from fascicle.build.segmentation_files import read_segmentation

    return read_segmentation(path)


def _recording(path: Path) -> Any:
    from fascicle import read_recording

    return read_recording(path)


def _tree(path: Path) -> Any:
    from fascicle.purkinje.tree_files import read_tree

    return read_tree(path, "lv", np.zeros(3))


def _electrodes(path: Path) -> Any:
    from fascicle.heart.electrodes import read_electrodes

    return read_electrodes(path)


def _heart(path: Path) -> Any:
    from fascicle import ForwardModel, load_heart

    return ForwardModel(load_heart(path)).simulate(seeds.parameters())


@cache
def small_model() -> ForwardModel:
    """A heart that is simulated in no time; prepared, and all that it runs compiled."""
    from fascicle.forward.model import ForwardModel

    model = ForwardModel(seeds.small_heart())
    model.simulate(seeds.parameters())
    return model


def _scenario(path: Path) -> Any:
    from fascicle.forward.model import ForwardModel
    from fascicle.forward.scenario_files import read_scenario
    from fascicle.heart.conduction import Conduction

    scenario, regions = read_scenario(path)
    model = small_model()
    if regions:
        model = ForwardModel(model.heart, Conduction.of(model.heart, regions))
    return model.simulate(seeds.parameters(), scenario)


def _parameters(path: Path) -> Any:
    from fascicle.core.parameters import read_parameters

    return small_model().simulate(read_parameters(path))


def _settings(path: Path) -> Any:
    from fascicle.networks.prior import read_settings, study_space
    from fascicle.networks.settings import checked_settings

    content = read_settings(path)
    parameters = content.pop("parameters", {})
    settings = checked_settings(content)
    return study_space(settings.method, parameters, small_model().heart)


def _target(path: Path) -> Any:
    from fascicle import read_target

    return read_target(path)


def _result(path: Path) -> Any:
    from fascicle.study.population import read_checks, read_population

    return read_population(path), read_checks(path)


def _study(path: Path) -> Any:
    from fascicle import load_study

    return load_study(path)


KINDS = {
    "meshes": Kind(seeds.meshes, _mesh),
    "trees": Kind(seeds.trees, _tree),
    "segmentations": Kind(seeds.segmentations, _segmentation),
    "electrodes": Kind(seeds.electrodes, _electrodes),
    "hearts": Kind(seeds.hearts, _heart),
    "recordings": Kind(seeds.recordings, _recording),
    "targets": Kind(seeds.targets, _target),
    "parameters": Kind(seeds.parameter_files, _parameters),
    "settings": Kind(seeds.settings_files, _settings),
    "scenarios": Kind(seeds.scenarios, _scenario),
    "results": Kind(seeds.results, _result),
    "studies": Kind(seeds.studies, _study),
}
