"""The recordings of a study: targets, each with the scenario that it was recorded in."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fascicle.core.errors import InputError
from fascicle.core.files import as_path, write_text
from fascicle.forward.scenario import Scenario
from fascicle.forward.scenario_files import find_scenario, read_scenario, scenario_text
from fascicle.recording.target import Target
from fascicle.recording.target_files import as_target, read_target, write_target

# A target, or one with its scenario
Given = Target | Path | str | tuple[Target | Path | str, Scenario | Path | str]


# A target, and what was done to the heart while it was recorded: None for the intrinsic beat
Recorded = tuple[Target, Scenario | None]


def digests(recorded: Recorded) -> tuple[str, str]:
    """SHA-256 of what a fit sees of target and scenario; empty without a scenario."""
    target, scenario = recorded
    text = hashlib.sha256(scenario_text(scenario).encode()).hexdigest() if scenario else ""
    return target_digest(target), text


def given_recordings(given: Given | list[Given]) -> list[Recorded]:
    """Read what is not read yet; a list is of several recordings."""
    several = list(given) if isinstance(given, list) else [given]
    if not several:
        raise InputError("no target is given; make one with 'fascicle target'")
    return [_recording(one) for one in several]


def _recording(given: Given) -> Recorded:
    pair = given if isinstance(given, tuple) else (given, None)
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
    """Keep recordings in a study's folder, where they are not kept yet, or are damaged."""
    for number, recorded in enumerate(recordings, 1):
        target, scenario = recording_paths(folder, number)
        if _kept(target, scenario) == digests(recorded):
            continue
        write_target(recorded[0], target)
        if recorded[1] is not None:
            write_text(scenario, scenario_text(recorded[1]))
        else:
            scenario.unlink(missing_ok=True)


def _kept(target: Path, scenario: Path) -> tuple[str, str] | None:
    """Digests of what is kept, if it can be read."""
    try:
        return digests(_read(target, scenario))
    except InputError:
        return None


def _read(target: Path, scenario: Path) -> Recorded:
    there = read_scenario(scenario)[0] if scenario.exists() else None
    return read_target(target), there


def read_recordings(folder: Path, count: int) -> list[Recorded]:
    """Read what `write_recordings` has written."""
    return [_read(*recording_paths(folder, number)) for number in range(1, count + 1)]


def recording_paths(folder: Path, number: int) -> tuple[Path, Path]:
    """Files of a recording, which are numbered from the second on."""
    end = f"-{number}" if number > 1 else ""
    return folder / f"target{end}.nc", folder / f"scenario{end}.toml"


def target_digest(target: Target) -> str:
    """SHA-256 of what the fit sees of a target."""
    digest = hashlib.sha256()
    numbers = [target.qrs_onset, target.qrs_offset, target.onset_sd, target.offset_sd]
    if target.noise is not None:
        numbers.append(target.noise)
    for array in (target.beats, target.time, np.array(numbers)):
        digest.update(str(array.shape).encode())
        digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    for one in target.filters:  # how they are known does not matter
        text = f"{one.kind.value} {one.frequency!r} {one.shape!r} {one.sampling_rate!r}"
        digest.update(text.encode())
    return digest.hexdigest()
