"""Recordings of a study: targets, with the scenarios in which they were recorded."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.errors import InputError
from fascicle.core.files import as_path, write_text
from fascicle.forward.scenario import Scenario
from fascicle.forward.scenario_files import find_scenario, read_scenario, scenario_text
from fascicle.recording.target import Target
from fascicle.recording.target_files import as_target, read_target, write_target

# Target, or target with its scenario, as the user passes it
Given = Target | Path | str | tuple[Target | Path | str, Scenario | Path | str]


# Target, and the scenario in which it was recorded: None for the intrinsic beat
Recorded = tuple[Target, Scenario | None]


def digests(recorded: Recorded) -> tuple[str, str]:
    """SHA-256 of target and scenario, as far as a fit uses them; the latter empty without one."""
    target, scenario = recorded
    text = hashlib.sha256(scenario_text(scenario).encode()).hexdigest() if scenario else ""
    return target_digest(target), text


def given_recordings(recordings: Given | list[Given]) -> list[Recorded]:
    """Read targets and scenarios that are files or names; a list holds several recordings."""
    targets = list(recordings) if isinstance(recordings, list) else [recordings]
    if not targets:
        raise InputError("no target is given; make one with 'fascicle target'")
    return [_recording(target) for target in targets]


def _recording(target_and_scenario: Given) -> Recorded:
    pair: Any = target_and_scenario
    if not isinstance(pair, tuple):
        pair = pair, None
    if len(pair) != 2:
        raise InputError(f"target is a tuple of {len(pair)}; give (target, scenario), or a list")
    target, scenario = as_target(pair[0]), pair[1]
    if scenario is not None and not isinstance(scenario, Scenario):
        named = as_path(scenario, "scenario of a target", "a scenario, its name, or its file")
        path = find_scenario(str(named))
        scenario, regions = read_scenario(path)
        if regions:
            raise InputError(
                f"{path}: has regions of the myocardium, which are the heart's in every "
                "recording; say them in its heart.toml"
            )
    return target, scenario


def write_recordings(folder: Path, recordings: Sequence[Recorded]) -> None:
    """Write recordings to a study's folder, unless they are there already, undamaged."""
    for number, recorded in enumerate(recordings, 1):
        target, scenario = recording_paths(folder, number)
        with suppress(InputError):  # it is missing or damaged
            if digests(_read(target, scenario)) == digests(recorded):
                continue
        write_target(recorded[0], target)
        if recorded[1] is not None:
            write_text(scenario, scenario_text(recorded[1]))
        else:
            scenario.unlink(missing_ok=True)


def _read(target: Path, scenario: Path) -> Recorded:
    recorded_scenario = read_scenario(scenario)[0] if scenario.exists() else None
    return read_target(target), recorded_scenario


def read_recordings(folder: Path, count: int) -> list[Recorded]:
    """Read the recordings that `write_recordings` has written."""
    return [_read(*recording_paths(folder, number)) for number in range(1, count + 1)]


def recording_paths(folder: Path, number: int) -> tuple[Path, Path]:
    """Files of a recording; their names have numbers from the second recording on."""
    end = f"-{number}" if number > 1 else ""
    return folder / f"target{end}.nc", folder / f"scenario{end}.toml"


def target_digest(target: Target) -> str:
    """SHA-256 of a target, as far as a fit uses it."""
    digest = hashlib.sha256()
    numbers = [target.qrs_onset, target.qrs_offset, target.onset_sd, target.offset_sd]
    if target.noise is not None:
        numbers.append(target.noise)
    for array in (target.beats, target.time, np.array(numbers)):
        digest.update(str(array.shape).encode())
        digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    for filter_ in target.filters:  # without the source of this knowledge
        text = (
            f"{filter_.kind.value} {filter_.frequency!r} {filter_.shape!r} "
            f"{filter_.sampling_rate!r}"
        )
        digest.update(text.encode())
    return digest.hexdigest()
