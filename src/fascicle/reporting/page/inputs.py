"""What a study was given, and the commands that make it and its report again."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from typing import Any

from fascicle.core.parameters import Parameter
from fascicle.core.quantities import SIDES, SPEED, fascicles, quantity
from fascicle.forward.scenario_files import name_in_library
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import INTRINSIC
from fascicle.recording.target import Target
from fascicle.reporting.names import parameter_name
from fascicle.study.fit import HEART
from fascicle.study.fitted import FittedStudy
from fascicle.study.recordings import recording_paths
from fascicle.study.settings import OF_THE_PAPER, OF_THE_POSTERIOR
from fascicle.study.study import StudyConfig

CONDUCTIVITIES = {  # mS/cm; `fascicle.heart.conduction.Conduction` explains them
    "intracellular_l": "intracellular conductivity along the fibre",
    "intracellular_t": "intracellular conductivity across the fibre",
    "extracellular_l": "extracellular conductivity along the fibre",
    "extracellular_t": "extracellular conductivity across the fibre",
    "torso": "conductivity of the unbounded conductor",
    "body": "conductivity of the torso but for lungs and blood",
    "lung": "conductivity of the lungs",
    "blood": "conductivity of the blood",
}
# Options of ``fascicle target``, by what the provenance calls the choice
CHOICES = {
    "choice_sampling_rate_hz": "--sampling-rate",
    "choice_unit": "--unit",
    "choice_leads": "--leads",
    "inverted": "--invert",
    "swapped": "--swap",
    "choice_class": "--class",
    "choice_beats": "--beats",
    "choice_exclude": "--exclude-beat",
    "choice_noise_mV": "--noise",
    "choice_lowpass_hz": "--lowpass",
    "choice_notch_hz": "--notch",
    "choice_recorder_lowpass_hz": "--recorder-lowpass",
}
Row = tuple[str, str, str]  # what it is called, its name in files and options, value


def learnt(config: StudyConfig) -> list[Row]:
    """Quantities that are learnt, with their priors."""
    return [(parameter_name(p.name), p.name, _prior_text(p)) for p in config.space]


def held(fitted: FittedStudy) -> list[Row]:
    """Quantities that are held at a value, and act: neither learnt, nor of a torso not there."""
    config, model = fitted.study.config, fitted.simulator.model
    regions = {
        f"region_{region.label}_conductivity": region.conductivity
        for region in model.conduction.regions
    }
    values = {**config.growth, **config.conduction, **regions, **config.fixed}
    without_effect = {*config.parameter_space.names}
    if {*without_effect, *config.fixed} & {*SPEED}:  # one of them replaces the others
        without_effect |= {*SPEED} - {*config.fixed}
    without_effect |= {"body", "lung", "blood"} if model.heart.torso is None else {"torso"}
    return [
        _held(name, value)
        for name, value in values.items()
        if value is not None and name not in without_effect and not name.startswith("of ")
    ]


def settings(config: StudyConfig) -> dict[str, Any]:
    """Settings of the method that was used."""
    of_the_method = OF_THE_PAPER if config.method == "paper" else OF_THE_POSTERIOR
    names = ("method", *of_the_method, "fewest_junctions", "seed")
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


def _prior_text(parameter: Parameter) -> str:
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    within = f"{parameter.lower:.4g} to {parameter.upper:.4g}{unit}"
    if parameter.median is None or parameter.sd is None:
        return f"{parameter.prior}, {within}"
    of = " of the logarithm" if parameter.prior == "log-normal" else ""
    middle = f"median {parameter.median:.4g}, standard deviation {parameter.sd:.4g}{of}"
    return f"{parameter.prior}, {middle}, within {within}"


def _held(name: str, value: float) -> Row:
    if name in CONDUCTIVITIES:
        return CONDUCTIVITIES[name], "", f"{value:g} mS/cm"
    unit = quantity(name).unit
    return parameter_name(name), name, f"{value:g}" if unit == "1" else f"{value:g} {unit}"


def commands(fitted: FittedStudy, predicted: Mapping[str, Predicted], against: str) -> list[str]:
    """What to type, a line each, for a shell; the settings go into a file first."""
    lines: list[str] = []
    given: list[str] = []
    for number, recording in enumerate(fitted.recordings, 1):
        kept, scenario = recording_paths(fitted.folder, number)
        made = f"target-{number}.nc"
        words = target_words(recording.target, made)
        lines += [shlex.join(words)] if words else []
        target = made if words else str(kept)
        given.append(f"{target}:{scenario}" if scenario.exists() else target)
    lines += ["cat > settings.toml <<'END'", *settings_file(fitted.study.config), "END"]
    fit = ["fascicle", "fit", str(fitted.folder / HEART), *given, "--out", str(fitted.folder)]
    report = report_words(fitted, predicted, against)
    return [*lines, shlex.join([*fit, "--settings", "settings.toml"]), shlex.join(report)]


def target_words(target: Target, out: str) -> list[str]:
    """Words of the command that makes a target of its recording; none, if no file is its source."""
    notes = target.provenance
    if "source_sha256" not in notes:
        return []
    words = ["fascicle", "target", notes["source"], "--out", out]
    if "shared_gain" in notes:
        words += ["--shared-gain", "--digits-per-mv", notes["shared_gain"].split()[0]]
    for name, option in CHOICES.items():
        if name in notes:  # exchanges are an option each, others a list
            values = notes[name].split(", ")
            for value in values if name == "swapped" else [",".join(values)]:
                words += [option, value]
    for end, time in (("onset", target.qrs_onset), ("offset", target.qrs_offset)):
        if notes.get(f"qrs_{end}_from") == "given":
            words += [f"--{end}", f"{float(time)!r}"]
    return words


def settings_file(config: StudyConfig) -> list[str]:
    """Lines of a settings file: the method's settings, all that is learnt, and what is fixed."""
    names = {*config.parameter_space.names, *config.fixed}
    fixed = {f"{side}_fascicles": fascicles(side, names) for side in SIDES} | config.fixed
    priors = []
    for each in config.space:
        numbers = {key: getattr(each, key) for key in ("lower", "upper", "median", "sd")}
        said = [f"{key} = {value!r}" for key, value in numbers.items() if value is not None]
        priors.append(f'{each.name} = {{ prior = "{each.prior}", {", ".join(said)} }}')
    return [
        *(f"{name} = {_toml(value)}" for name, value in settings(config).items()),
        "[parameters]",
        *(f"{name} = {value!r}" for name, value in fixed.items()),
        *priors,
    ]


def _toml(value: Any) -> str:
    return json.dumps(value) if isinstance(value, str | bool) else repr(value)


def report_words(
    fitted: FittedStudy, predicted: Mapping[str, Predicted], against: str
) -> list[str]:
    """Words of the command that makes the page, with files of scenarios where they were."""
    words = ["fascicle", "report", str(fitted.folder)]
    for name, found in predicted.items():
        if name != INTRINSIC:
            source = None if name_in_library(found.scenario) else found.scenario.source
            words += ["--scenario", source or name]
    return words if against == INTRINSIC else [*words, "--against", against]
