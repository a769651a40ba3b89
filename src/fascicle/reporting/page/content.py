"""Text of the report: results of the fit, its inputs, and the commands that repeat it."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from typing import Any

import numpy as np

from fascicle.core.conduction_states import FASCICULAR_BLOCKS
from fascicle.core.parameters import Parameter
from fascicle.core.quantities import SIDES, SPEED, fascicles, parameter_name, quantity
from fascicle.forward.scenario_files import name_in_library
from fascicle.networks.settings import SETTINGS_OF
from fascicle.networks.target_comparison import recording_paths
from fascicle.prediction.comparison import compare, missing_blocks
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import INTRINSIC
from fascicle.purkinje.growth import GrowthRules
from fascicle.recording.target import Target
from fascicle.reporting.names import index_name, scenario_name
from fascicle.study.fitted import FittedStudy
from fascicle.study.statements import Caution
from fascicle.study.study import StudyConfig, StudyFile

Row = tuple[str, str, str]  # name for readers, name in files and options, value


def meaning(fitted: FittedStudy) -> list[str]:
    """Explain the verdict in full sentences."""
    count, checks = len(fitted.population), fitted.checks
    if fitted.of_the_paper:
        return [
            f"{count} networks were accepted by the paper's rule. They are a population and not a "
            "posterior: their spread does not measure uncertainty."
        ]
    if not fitted.statements.converged:
        return [
            "The two runs are incomplete or disagree: do not rely on any number below. "
            "A warning says how to continue."
        ]
    sentences = [
        f"Two independent runs agree. The {count} networks below are equally probable; their "
        "spread is the uncertainty that remains given the ECG."
    ]
    if fitted.statements.states:
        fascicular = {*FASCICULAR_BLOCKS} & {*getattr(fitted.population, "states", {})}
        sentences.append(
            "The first line begins with how probable each conduction state is given this ECG. Each "
            "network is of one state, and keeps in every prediction what is blocked in it."
            + " Fascicular blocks are recognised by the frontal axis: no network has one, and "
            "their share of the networks is normal." * bool(fascicular)
        )
    if checks is not None and checks.acceptable:
        sentences.append(
            f"{checks.explained_in_words}. QRS duration, frontal axis and independent leads differ "
            "by no more than the errors that the model allows."
        )
    elif checks is not None:
        sentences.append(
            f"They do not reproduce the recorded QRS: {'; '.join(checks.failures)}. The heart, the "
            "torso or the model does not match the patient: the intervals below come from a model "
            "that does not fit."
        )
    return sentences


def prediction(
    name: str, predicted: Mapping[str, Predicted], against: str, caution: Caution | None
) -> str:
    """QRS durations and total activation time of a scenario, and how it compares with another."""
    paced, other = predicted[name], predicted[against]
    durations = []
    for index in ("qrs_duration", "total_activation_time"):
        low, middle, high = np.nanpercentile(paced.indices[index], [5, 50, 95])
        durations.append(f"{index_name(index)} {middle:.0f} ms ({low:.0f} to {high:.0f})")
    sentence = ", ".join(durations)
    if caution is not None:
        sentence = f"{caution.brief}: {sentence}"
    if name in (against, INTRINSIC):
        return f"{sentence}."
    if missing := missing_blocks(name, predicted, against):
        sentence = f"{sentence}. Caution: {missing}"
    beat = "the intrinsic beat" if against == INTRINSIC else scenario_name(against)
    reduction = compare(paced, other, "total_activation_time")
    shorter = f"P(shorter) = {reduction.probability():.2f}"
    return f"{sentence}. Activation {reduction.change} compared with {beat}; {shorter}."


def learnt(config: StudyConfig) -> list[Row]:
    """Quantities that are learnt, with their priors."""
    return [(parameter_name(p.name), p.name, _prior_text(p)) for p in config.space]


def held(fitted: FittedStudy) -> list[Row]:
    """Quantities with a fixed value that affects the result."""
    labels = {  # mS/cm; `fascicle.heart.conduction.Conduction` explains them
        "intracellular_l": "intracellular conductivity along the fibre",
        "intracellular_t": "intracellular conductivity across the fibre",
        "extracellular_l": "extracellular conductivity along the fibre",
        "extracellular_t": "extracellular conductivity across the fibre",
        "torso": "conductivity of the unbounded conductor",
        "body": "conductivity of the torso without lungs and blood",
        "lung": "conductivity of the lungs",
        "blood": "conductivity of the blood",
    }
    config, model = fitted.study.config, fitted.simulator.model
    tissues = model.conduction.regions
    regions = {f"region_{region.label}_conductivity": region.conductivity for region in tissues}
    values = {**config.growth, **config.conduction, **regions, **config.fixed}
    without_effect = {*config.prior.names}
    if {*without_effect, *config.fixed} & {*SPEED}:  # both set the same conduction velocity
        without_effect |= {*SPEED} - {*config.fixed}
    without_effect |= {"body", "lung", "blood"} if model.heart.torso is None else {"torso"}
    rows: list[Row] = []
    for name, value in values.items():
        if value is None or name in without_effect or name.startswith("of "):
            continue
        if name in labels:
            rows.append((labels[name], "", f"{value:g} mS/cm"))
        else:
            fixed_quantity = quantity(name)
            text = fixed_quantity.choices[int(value)] if fixed_quantity.choices else f"{value:g}"
            rows.append((parameter_name(name), name, _with_unit(text, fixed_quantity.unit)))
    return rows


def settings(config: StudyConfig) -> dict[str, Any]:
    """Settings that the method of the fit uses."""
    names = ("method", *SETTINGS_OF[config.method], "fewest_junctions", "seed")
    return {name: getattr(config, name) for name in names}


def recordings(fitted: FittedStudy) -> list[tuple[str, str]]:
    """File of each recording, and the provenance of its target."""
    rows = []
    for number, recording in enumerate(fitted.recordings, 1):
        notes = dict(recording.target.provenance)
        of = f" {number}" if len(fitted.recordings) > 1 else ""
        rows.append((f"recording{of}", notes.pop("source", "in memory")))
        rows.append((f"target{of}", "; ".join(f"{key}: {value}" for key, value in notes.items())))
    return [(name, value) for name, value in rows if value]


def hearts(fitted: FittedStudy) -> list[tuple[str, str]]:
    """Hearts of an atlas in the networks, the most probable first; empty for one heart."""
    atlas = fitted.simulator.model.heart.atlas
    numbers = getattr(fitted.population, "averaged", {}).get("atlas_heart")
    if atlas is None or numbers is None:
        return []
    which, counts = np.unique(numbers.astype(int), return_counts=True)
    ranked = np.argsort(-counts, kind="stable")
    shares = [f"number {which[k]} in {counts[k] / len(numbers):.0%}" for k in ranked[:5]]
    more = ["…"] if len(which) > len(shares) else []
    text = f"{len(which)} of the {len(atlas)} of the atlas: {', '.join(shares + more)}"
    return [("hearts of the networks", text)]


def _prior_text(parameter: Parameter) -> str:
    within = _with_unit(f"{parameter.lower:.4g} to {parameter.upper:.4g}", parameter.unit)
    if parameter.median is None or parameter.sd is None:
        return f"{parameter.prior}, {within}"
    of = " of the logarithm" if parameter.prior == "log-normal" else ""
    middle = f"median {parameter.median:.4g}, standard deviation {parameter.sd:.4g}{of}"
    return f"{parameter.prior}, {middle}, within {within}"


def _with_unit(text: str, unit: str) -> str:
    return text if unit == "1" else f"{text} {unit}"


def commands(fitted: FittedStudy, predicted: Mapping[str, Predicted], against: str) -> list[str]:
    """Lines for a shell that repeat the fit and the report; the settings go into a file first."""
    config, lines, targets = fitted.study.config, [], []
    default, term = GrowthRules(), config.growth_term
    if (config.growth, term) != (default.numbers, default.term.function.__name__):
        lines.append(
            f"# The networks grew by rules given in Python (rules=, growth term '{term}'): "
            "the commands below do not pass them on; call fascicle.fit instead."
        )
    for number, recording in enumerate(fitted.recordings, 1):
        stored, scenario = recording_paths(fitted.folder, number)
        target_file = f"target-{number}.nc"
        words = target_words(recording.target, target_file)
        lines += [shlex.join(words)] if words else []
        target = target_file if words else str(stored)
        targets.append(f"{target}:{scenario}" if scenario.exists() else target)
    lines += ["cat > settings.toml <<'END'", *settings_file(config), "END"]
    heart, out = str(fitted.folder / StudyFile.HEART), str(fitted.folder)
    fit = ["fascicle", "fit", heart, *targets, "--out", out]
    report = report_words(fitted, predicted, against)
    return [*lines, shlex.join([*fit, "--settings", "settings.toml"]), shlex.join(report)]


def target_words(target: Target, out: str) -> list[str]:
    """Command that makes a target from its recording, as words; none without a source file."""
    # options by the name of the choice in the provenance
    options = {
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
    notes = target.provenance
    if "source_sha256" not in notes:
        return []
    words = ["fascicle", "target", notes["source"], "--out", out]
    if "shared_gain" in notes:
        words += ["--shared-gain", "--digits-per-mv", notes["shared_gain"].split()[0]]
    for name, option in options.items():
        if name in notes:  # one option per swapped pair, one list for any other choice
            values = notes[name].split(", ")
            for value in values if name == "swapped" else [",".join(values)]:
                words += [option, value]
    for end, time in (("onset", target.qrs_onset), ("offset", target.qrs_offset)):
        if notes.get(f"qrs_{end}_from") == "given":
            words += [f"--{end}", f"{float(time)!r}"]
    return words


def settings_file(config: StudyConfig) -> list[str]:
    """Lines of a settings file: settings of the method, fixed values and priors."""
    names = {*config.prior.names, *config.fixed}
    fixed = {f"{side}_fascicles": fascicles(side, names) for side in SIDES} | config.fixed
    if config.mapped:
        fixed["conduction"] = 0.0
    priors = []
    for parameter in config.space:
        numbers = {key: getattr(parameter, key) for key in ("lower", "upper", "median", "sd")}
        keys = [f"{key} = {value!r}" for key, value in numbers.items() if value is not None]
        priors.append(f'{parameter.name} = {{ prior = "{parameter.prior}", {", ".join(keys)} }}')
    return [
        *(f"{name} = {json.dumps(value)}" for name, value in settings(config).items()),
        "[parameters]",
        *(f"{name} = {value!r}" for name, value in fixed.items()),
        *priors,
        *(["[parameters.conduction]"] if config.states else []),
        *(f"{json.dumps(name)} = {probability!r}" for name, probability in config.states.items()),
    ]


def report_words(
    fitted: FittedStudy, predicted: Mapping[str, Predicted], against: str
) -> list[str]:
    """Command that makes the page, as words, with the scenarios' files."""
    words = ["fascicle", "report", str(fitted.folder)]
    for name, simulated in predicted.items():
        if name != INTRINSIC:
            source = None if name_in_library(simulated.scenario) else simulated.scenario.source
            words += ["--scenario", source or name]
    return words if against == INTRINSIC else [*words, "--against", against]
