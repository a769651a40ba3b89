"""The commands that make a study and its report again: target, fit, report."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping

from fascicle.core.parameters import Parameter, free
from fascicle.core.quantities import SIDES, default_of, fascicles
from fascicle.forward.scenario_files import name_in_library
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import INTRINSIC
from fascicle.recording.target import Target
from fascicle.reporting.page.inputs import settings
from fascicle.study.fit import HEART
from fascicle.study.fitted import FittedStudy
from fascicle.study.recordings import recording_paths
from fascicle.study.settings import FitSettings
from fascicle.study.space import study_space
from fascicle.study.study import StudyConfig

SETTINGS_FILE = "settings.toml"
FROM_A_FILE = "source_sha256"  # in the provenance of a target that was made of a file
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
REPEATED = ("swapped",)  # one option each


def commands(fitted: FittedStudy, predicted: Mapping[str, Predicted], against: str) -> list[str]:
    """What to type, a line each, for a shell; settings that no option says go into a file first.

    Parameters
    ----------
    fitted : FittedStudy
        The study.
    predicted : mapping of name to Predicted
        What its report predicts, the intrinsic beat among them.
    against : str
        That of them which the others are compared with.
    """
    targets = [recording.target for recording in fitted.recordings]
    made = [target_words(target, f"target{_end(n)}.nc") for n, target in enumerate(targets, 1)]
    learnt, priors = _parameters(fitted)
    lines = [shlex.join(words) for words in made if words]
    if priors:
        lines += [f"cat > {SETTINGS_FILE} <<'END'", "[parameters]", *priors, "END"]
        learnt += ["--settings", SETTINGS_FILE]
    fit = ["fascicle", "fit", str(fitted.folder / HEART), *_given(fitted, made)]
    fit += ["--out", str(fitted.folder), *_settings(fitted.study.config), *learnt]
    return [*lines, shlex.join(fit), shlex.join(report_words(fitted, predicted, against))]


def target_words(target: Target, out: str) -> list[str]:
    """Words of the command that makes a target of its recording; none, if no file is its source."""
    notes = target.provenance
    if FROM_A_FILE not in notes:
        return []
    words = ["fascicle", "target", notes["source"], "--out", out]
    if "shared_gain" in notes:
        words += ["--shared-gain", "--digits-per-mv", notes["shared_gain"].split()[0]]
    for name, option in CHOICES.items():
        for value in _values(name, notes.get(name)):
            words += [option, value]
    for end, time in (("onset", target.qrs_onset), ("offset", target.qrs_offset)):
        if notes.get(f"qrs_{end}_from") == "given":
            words += [f"--{end}", _number(time)]
    return words


def report_words(
    fitted: FittedStudy, predicted: Mapping[str, Predicted], against: str
) -> list[str]:
    """Words of the command that makes the page, with files of scenarios where they were."""
    words = ["fascicle", "report", str(fitted.folder)]
    for name, found in predicted.items():
        if name != INTRINSIC:
            own_file = None if name_in_library(found.scenario) else found.scenario.source
            words += ["--scenario", own_file or name]
    return words if against == INTRINSIC else [*words, "--against", against]


def _values(name: str, text: str | None) -> list[str]:
    """Values of an option from a list such as ``V1, V2``."""
    if text is None:
        return []
    return text.split(", ") if name in REPEATED else [text.replace(", ", ",")]


def _end(number: int) -> str:
    return f"-{number}" if number > 1 else ""


def _given(fitted: FittedStudy, made: list[list[str]]) -> Iterator[str]:
    """Targets, made again or as the study keeps them, with their scenarios."""
    for number, words in enumerate(made, 1):
        target, scenario = recording_paths(fitted.folder, number)
        path = f"target{_end(number)}.nc" if words else str(target)
        yield f"{path}:{scenario}" if scenario.exists() else path


def _settings(config: StudyConfig) -> list[str]:
    """Options of the method's settings that are not the defaults."""
    words = []
    for name, value in settings(config).items():
        if value != FitSettings.model_fields[name].default:
            option = f"--{name.replace('_', '-')}"
            words += [option] if value is True else [option, str(value)]
    return words


def _parameters(fitted: FittedStudy) -> tuple[list[str], list[str]]:
    """Options that say what is learnt and fixed, and lines of a settings file for other priors."""
    config, heart = fitted.study.config, fitted.simulator.model.heart
    names = {*config.parameter_space.names, *config.fixed}
    counts = {f"{side}_fascicles": fascicles(side, names) for side in SIDES}
    fixed = {name: n for name, n in counts.items() if n != default_of(name)} | config.fixed
    space, _ = study_space(config.method, counts, heart)
    usual = {parameter.name: parameter for parameter in space.parameters}
    words, priors = [], []
    for name, value in fixed.items():
        words += ["--fix", f"{name}={_number(value)}"]
    for parameter in config.space:
        if parameter == usual.get(parameter.name):
            continue
        if parameter == free(parameter.name):
            words += ["--free", parameter.name]
        else:
            priors.append(f"{parameter.name} = {_prior(parameter)}")
    return words, priors


def _prior(parameter: Parameter) -> str:
    """A prior in TOML."""
    numbers = {key: getattr(parameter, key) for key in ("lower", "upper", "median", "sd")}
    said = [f"{key} = {value!r}" for key, value in numbers.items() if value is not None]
    return f'{{ prior = "{parameter.prior}", {", ".join(said)} }}'


def _number(value: float) -> str:
    """As short as it can be read back."""
    return f"{value:g}" if float(f"{value:g}") == value else repr(float(value))
