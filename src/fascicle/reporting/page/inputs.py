"""What a study was given: what is learnt, what is held fixed, settings, recordings."""

from __future__ import annotations

from typing import Any

from fascicle.core.parameters import Parameter
from fascicle.core.quantities import SPEED, quantity
from fascicle.heart.heart import Heart
from fascicle.reporting.names import parameter_name
from fascicle.study.fitted import FittedStudy
from fascicle.study.settings import OF_THE_PAPER, OF_THE_POSTERIOR
from fascicle.study.study import StudyConfig

CONDUCTIVITIES = {  # mS/cm; `fascicle.heart.conduction.Conduction` explains them
    "intracellular_l": "intracellular conductivity along the fibre",
    "intracellular_t": "intracellular conductivity across the fibre",
    "extracellular_l": "extracellular conductivity along the fibre",
    "extracellular_t": "extracellular conductivity across the fibre",
    "torso": "conductivity of the unbounded conductor",
    "body": "conductivity of the body but for lungs and blood",
    "lung": "conductivity of the lungs",
    "blood": "conductivity of the blood",
}
OF_A_TORSO = ("body", "lung", "blood")
Row = tuple[str, str, str]  # what it is called, its name in files and options, value


def learnt(config: StudyConfig) -> list[Row]:
    """Quantities that are learnt, with their priors."""
    return [(parameter_name(p.name), p.name, prior_text(p)) for p in config.space]


def prior_text(parameter: Parameter) -> str:
    """A prior in words."""
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    within = f"{parameter.lower:.4g} to {parameter.upper:.4g}{unit}"
    if parameter.median is None or parameter.sd is None:
        return f"{parameter.prior}, {within}"
    of = " of the logarithm" if parameter.prior == "log-normal" else ""
    middle = f"median {parameter.median:.4g}, standard deviation {parameter.sd:.4g}{of}"
    return f"{parameter.prior}, {middle}, within {within}"


def held(fitted: FittedStudy) -> list[Row]:
    """Quantities that are held at a value, and act: neither learnt, nor of a body not there."""
    config, model = fitted.study.config, fitted.simulator.model
    values = {**config.growth, **config.conduction, **_regions(fitted), **config.fixed}
    not_said = {*config.parameter_space.names, *_without_effect(config, model.heart)}
    return [
        _held(name, value)
        for name, value in values.items()
        if value is not None and name not in not_said and not name.startswith("of ")
    ]


def settings(config: StudyConfig) -> dict[str, Any]:
    """Settings of the method that was used."""
    own = OF_THE_PAPER if config.method == "paper" else OF_THE_POSTERIOR
    names = ("method", *own, "fewest_junctions", "seed")
    return {name: getattr(config, name) for name in names}


def recordings(fitted: FittedStudy) -> list[tuple[str, str]]:
    """Where each recording comes from, and all that its target says of itself."""
    found = []
    for number, recording in enumerate(fitted.recordings, 1):
        notes = dict(recording.target.provenance)
        of = f" {number}" if len(fitted.recordings) > 1 else ""
        found.append((f"recording{of}", notes.pop("source", "in memory")))
        said = "; ".join(f"{name}: {value}" for name, value in notes.items())
        found.append((f"target{of}", said))
    return [(name, value) for name, value in found if value]


def digests(config: StudyConfig) -> list[tuple[str, str]]:
    """Hashes by which heart and targets are known again."""
    targets = (config.target, *config.other_targets)
    return [("heart (SHA-256)", config.heart), ("target (SHA-256)", ", ".join(targets))]


def _regions(fitted: FittedStudy) -> dict[str, float]:
    """Factors on the conductivities of the heart's regions, by the names of their quantities."""
    regions = fitted.simulator.model.conduction.regions
    return {f"region_{region.label}_conductivity": region.conductivity for region in regions}


def _without_effect(config: StudyConfig, heart: Heart) -> set[str]:
    """Names of what another value replaces, and of tissues that are not there."""
    names = {*config.parameter_space.names, *config.fixed}
    said = {name for name in SPEED if name not in config.fixed} if names & {*SPEED} else set()
    return said | ({*OF_A_TORSO} if heart.torso is None else {"torso"})


def _held(name: str, value: float) -> Row:
    if name in CONDUCTIVITIES:
        return CONDUCTIVITIES[name], "", f"{value:g} mS/cm"
    unit = quantity(name).unit
    return parameter_name(name), name, f"{value:g}" if unit == "1" else f"{value:g} {unit}"
