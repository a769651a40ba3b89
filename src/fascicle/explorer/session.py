"""Answers of the explorer: activation, trees and ECG of the parameters that a page sends.

A page sends its complete state with every change, and the session stores no state of a page. So
undo, comparisons and several pages need nothing but states. An answer is a length (4 bytes,
little-endian), that many bytes of JSON, and the arrays that it names, each from a multiple of four
bytes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError

from fascicle.core.arrays import Floats, Integers
from fascicle.core.conduction_states import CONDUCTION_STATES
from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.core.parameters import (
    HUMAN_SPACE,
    NETWORK_SPACE,
    Infeasible,
    Parameter,
    ParameterSpace,
    free,
)
from fascicle.core.progress import ProgressLines
from fascicle.core.quantities import (
    SHOWN_UNITS,
    SPEED,
    TORSO_QUANTITIES,
    checked,
    parameter_name,
    quantity,
    torso_values,
)
from fascicle.forward.electrocardiogram import SAMPLE_STEP
from fascicle.forward.model import ForwardModel, without_heart
from fascicle.forward.primitives import His, SlowConduction, Stimulus
from fascicle.forward.scenario import Primitive, Scenario
from fascicle.forward.scenario_files import library, read_scenarios, scenario_text
from fascicle.forward.simulation_files import example_parameters
from fascicle.heart.conduction import Region
from fascicle.networks.target_comparison import TargetComparison
from fascicle.prediction.scenarios import INTRINSIC
from fascicle.reporting.names import scenario_name
from fascicle.reporting.page.scene import body_axes, boundary
from fascicle.study.fitted import FittedStudy
from fascicle.torso.conductor import TorsoState

Coordinate = Annotated[float, Field(ge=-1e4, le=1e4, allow_inf_nan=False)]
Place = tuple[Coordinate, Coordinate, Coordinate]


class PageState(BaseModel, extra="forbid"):
    """State of a page: parameters, scenario, and places that were clicked.

    Attributes
    ----------
    values : mapping of name to float
        Quantities of the network, in their units.
    scenario : str
        Name in the `library`.
    stimuli : list of Place
        Paced places of the myocardium (mm), all at 0 ms; without a scenario no root fires then.
    blocks : list of (str, Place)
        Trees, and places of them (mm) that do not conduct.
    scars : list of Place
        Places of the myocardium (mm) around which there is scar.
    network : int, optional
        The network of the study, from 0, with whose gain and torso the ECG is shown. Quantities of
        the torso change it from there.
    """

    values: dict[str, float]
    scenario: str = INTRINSIC
    stimuli: list[Place] = Field(default=[], max_length=20)
    blocks: list[tuple[str, Place]] = Field(default=[], max_length=20)
    scars: list[Place] = Field(default=[], max_length=20)
    network: int | None = Field(default=None, ge=0)

    @classmethod
    def of(cls, message: Any) -> PageState:
        """Check the message of a page."""
        try:
            return cls.model_validate(message)
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(map(str, first["loc"]))
            raise InputError(f"state: '{place}': {first['msg']}; reload the page") from None

    def beat(self) -> Scenario | None:
        """Scenario of this state; None for an intrinsic beat without blocks."""
        name, primitives = self.scenario, list[Primitive]()
        if name != INTRINSIC:
            if name not in library():
                raise InputError(f"scenario: '{name}' is not in the library; reload the page")
            primitives += read_scenarios(name)[name].primitives
        elif self.stimuli:  # as in the library's pacings
            primitives.append(His(time=np.inf))
        primitives += [Stimulus(time=0.0, position=place) for place in self.stimuli]
        primitives += [
            SlowConduction(tree=tree, speed=0.0, centre=place, radius=3.0)  # mm
            for tree, place in self.blocks
        ]
        return Scenario(primitives) if primitives else None

    @property
    def regions(self) -> tuple[Region, ...]:
        """Scars of this state."""
        return tuple(  # spheres of 8 mm
            Region(conductivity=0.0, centre=place, radius=8.0) for place in self.scars
        )


@dataclass(frozen=True)
class Session:
    """Heart to explore, perhaps with a recording or a study.

    Attributes
    ----------
    model : ForwardModel
        Forward model of the heart.
    recording : TargetComparison, optional
        Recording with which simulated ECGs are compared.
    study : FittedStudy, optional
        Study whose networks can be shown one by one.
    """

    model: ForwardModel
    recording: TargetComparison | None = None
    study: FittedStudy | None = None

    @classmethod
    def of_study(cls, study: FittedStudy) -> Session:
        """Explore a study: its heart, its first recording, its networks."""
        return cls(study.simulator.model, study.recordings[0], study)

    @cached_property
    def space(self) -> ParameterSpace:
        """Parameters with a slider: those of the study, or of the networks, and α."""
        if self.study is not None:
            return self.study.simulator.prior.learnt
        paper = (*NETWORK_SPACE.parameters, free("alpha"))
        human = "interventricular_delay" in self.start
        usual = HUMAN_SPACE.parameters if human else paper
        return ParameterSpace(
            tuple(parameter for parameter in usual if parameter.name in self.start)
        )

    @cached_property
    def surface(self) -> tuple[Integers, Integers, int]:
        """Boundary of the heart, as the page draws it (`boundary`)."""
        return boundary(self.model.heart)

    def description(self) -> bytes:
        """Description of the session: surface, sliders, scenarios, recording, networks."""
        triangles, shown, endocardial = self.surface
        heart, networks = self.model.of_heart(self.start).heart, []
        if self.study is not None:
            population, fixed = self.study.population, self.study.simulator.prior.fixed
            values = (population.parameters(k) for k in range(len(population)))
            networks = [_spoken({**fixed, **parameters}) for parameters in values]
        content: dict[str, Any] = {
            "heart": self.model.heart.name,
            **body_axes(heart),
            "endocardial": endocardial,
            "leads": list(LEADS),
            "groups": [
                {"name": name, "sliders": [self._slider(parameter) for parameter in parameters]}
                for name, parameters in self.groups.items()
            ],
            "conduction": [*CONDUCTION_STATES],
            "scenarios": {name: scenario_name(name) for name in (INTRINSIC, *library())},
            "start": _spoken(self.start),
            "verdict": None if self.study is None else self.study.verdict,
            "networks": networks,
        }
        arrays = {
            "vertices": heart.vertices[shown].astype("<f4"),
            "triangles": triangles.astype("<u4"),
        }
        return packed(content, arrays)

    @property
    def groups(self) -> dict[str, list[Parameter]]:
        """Quantities with a slider, by groups: `space`, then those that are not learnt."""
        growth = ("branch_length", "branch_angle", "repulsion")
        more = {
            "growth and junctions": (*growth, "anterograde_delay", "retrograde_delay"),
            # a tissue is prepared in seconds
            "tissue": ("anisotropy_ratio", "endocardial_layer", "endocardial_speed"),
        }
        atlas = self.model.heart.atlas
        if self.model.heart.has_torso and atlas is None:
            more["torso"] = TORSO_QUANTITIES
        groups = {"network": list(self.space.parameters)}
        if atlas is not None and len(atlas) > 1:
            groups["heart"] = [Parameter("atlas_heart", "1", 0.0, len(atlas) - 1.0)]
        learnt = {parameter.name for parameter in self.space.parameters}
        for group, names in more.items():
            groups[group] = [free(name) for name in names if name not in learnt]
        return groups

    @cached_property
    def start(self) -> dict[str, float]:
        """Values that a page begins with: of the study's best network, or the example's."""
        if self.study is None:
            example = example_parameters(self.model)
            if not {*SPEED} & {*example}:
                example["alpha"] = self.model.conduction.alpha
            return example
        return {**self.study.simulator.prior.fixed, **self.study.population.best}

    def answer(self, message: Any, report: Callable[[bytes], object] | None = None) -> bytes:
        """Simulate the state that a page sent; the answer states the reason if that is impossible.

        Messages for the page report the progress of long preparations.
        """

        def note(line: str) -> None:
            if report is not None:
                report(packed({"progress": line}, {}))

        number = None
        try:
            if not (isinstance(message, Mapping) and isinstance(message.get("state"), Mapping)):
                raise InputError("the page sent a damaged message; reload the page")
            number = message.get("id") if isinstance(message.get("id"), int) else None
            state = PageState.of(message["state"])
            if message.get("ask") == "files":
                return packed({"id": number, "files": self.files(state)}, {})
            lines = ProgressLines(note)
            try:
                named = {n: v for n, v in state.values.items() if n == "atlas_heart"}
                torso, model = torso_values(state.values), self.model.of_heart(checked(named))
                state = state.model_copy(update={"values": without_heart(state.values)})
                if torso and state.scars:
                    problem = "scar cannot be combined with a changed torso; undo one of them"
                    raise InputError(problem)
                if torso:
                    model.torso([*torso], lines)
                if state.scars:
                    model = self._scarred(model, state.regions)
                content, arrays = self._simulated(model, state, bool(message.get("moving")))
            finally:
                lines.end()
            return packed({"id": number, **content}, arrays)
        except InputError as error:
            return packed({"id": number, "error": str(error)}, {})

    def files(self, state: PageState) -> dict[str, str]:
        """Files by name that `fascicle simulate` takes, to repeat a state."""
        gain, _ = self._drawn(state)
        named = dict(state.values)
        if gain != 1:
            named["gain"] = gain * named.get("gain", 1.0)
        values = "".join(f"{name} = {value!r}\n" for name, value in named.items())
        beat = state.beat() or Scenario()
        return {"parameters.toml": values, "scenario.toml": scenario_text(beat, state.regions)}

    def _simulated(
        self, model: ForwardModel, state: PageState, moving: bool
    ) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Numbers and arrays of a beat; without conventional criteria while a slider is dragged.

        These take as long as the simulation.
        """
        beat = model.simulate(state.values, state.beat())
        if isinstance(beat, Infeasible):
            raise InputError(f"{beat.reason}; {beat.remedy}, or undo the last change")
        gain, torso = self._drawn(state)
        beat = replace(beat, leads=gain * torso @ beat.leads)
        begin = float(beat.activation.min())
        content: dict[str, Any] = {
            "qrs": beat.qrs_duration,
            "total": beat.total_activation_time,
            "axis": beat.frontal_axis,
        }
        if not moving:
            content["criteria"] = [
                criterion.name for criterion in beat.conventional_criteria if criterion.met
            ]
        arrays = {"activation": (beat.activation[self.surface[1]] - begin).astype("<f4")}
        for tree, times in zip(beat.trees, beat.coupled.trees, strict=True):
            ends = np.flatnonzero(tree.parents >= 0)
            arrays |= {
                f"{tree.side}_nodes": tree.nodes.astype("<f4"),  # mm
                f"{tree.side}_segments": np.column_stack([tree.parents[ends], ends]).astype("<u4"),
                f"{tree.side}_times": (times - begin).astype("<f4"),  # ms
            }
        content["trees"] = [tree.side for tree in beat.trees]
        arrays["electrodes"] = _electrodes(model, state).astype("<f4")
        if self.model.heart.atlas is not None:
            arrays["vertices"] = model.heart.vertices[self.surface[1]].astype("<f4")
        content["ecg_start"] = beat.onset - begin
        arrays["simulated"] = beat.leads[: len(LEADS)].astype("<f4")
        if self.recording is not None:
            target, alignment = self.recording.target, self.recording.align(beat.leads)
            under = self.recording.predicted(beat.leads, alignment)
            first = alignment.shift - target.qrs_samples.start - beat.first_activation
            content["ecg_start"] = first * SAMPLE_STEP
            content["explained"] = 1 - alignment.loss / self.recording.null_loss
            arrays["simulated"] = under[: len(LEADS)].astype("<f4")
            arrays["recorded"] = target.mean[: len(LEADS)].astype("<f4")
        return content, arrays

    def _drawn(self, state: PageState) -> tuple[float, Floats]:
        """Gain and torso (12 + k, 12 + k) that were drawn with the network of a state."""
        study, k = self.study, state.network
        plain = np.eye(len(self.model.heart.leads))
        if study is None or k is None:
            return 1.0, plain
        if k >= len(study.population):
            raise InputError(f"network: there is no {k}; reload the page")
        gain = 1.0 if study.gains is None else float(study.gains[k])
        return gain, plain if study.torsos is None else study.torsos[k]

    @cached_property
    def _scarred(self) -> Callable[[ForwardModel, tuple[Region, ...]], ForwardModel]:
        """Forward model with scars; it takes seconds to prepare, so the last ones are cached."""

        def with_scars(model: ForwardModel, regions: tuple[Region, ...]) -> ForwardModel:
            plain = model.conduction
            heart = replace(model.heart, folder=None)  # not to fill its folder with trials
            conduction = replace(plain, regions=(*plain.regions, *regions))
            return ForwardModel(heart, conduction, model.rules, model.action_potential)

        return lru_cache(3)(with_scars)

    def _slider(self, parameter: Parameter) -> dict[str, Any]:
        """Slider of a parameter: its range, and the histogram of its values in the study."""
        name = parameter.name
        low, high = parameter.lower, parameter.upper
        values = {} if self.study is None else self.study.population.values
        drawn = None
        if name in values and len(values[name]):
            drawn = np.histogram(values[name], bins=30, range=(low, high))[0].tolist()
        unit = {"1": "", **SHOWN_UNITS}.get(parameter.unit, parameter.unit)
        along, across = self.model.conduction.speeds
        # where a state does not name the quantity; None for those that it must name
        numbers = {**self.model.rules.numbers, **vars(self.model.conduction)}
        value = numbers.get(name, quantity(name).default)
        return {
            **({"step": 1} if quantity(name).is_integer else {}),
            "name": name, "label": parameter_name(name), "unit": unit, "low": low, "high": high,
            "posterior": drawn, "value": along / across if name == "anisotropy_ratio" else value,
            "meaning": quantity(name).meaning,
        }  # fmt: skip


def _electrodes(model: ForwardModel, state: PageState) -> Floats:
    """Positions (9 + a, 3) of the electrodes in the coordinates of the heart (mm)."""
    placed, torso = model.heart.electrode_positions, torso_values(state.values)
    if not torso:
        return placed
    # the response has them on vertices of the skin, some mm from there
    skin = model.torso([*torso]).response.electrodes
    return placed + skin(TorsoState.of(torso)) - skin(TorsoState.of({}))


def _spoken(values: Mapping[str, float]) -> dict[str, float | str]:
    """Values for JSON, which has no infinity, as the page sends them back."""
    return {name: v if np.isfinite(v) else "Infinity" for name, v in values.items()}


def packed(content: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """JSON and arrays of four-byte numbers as one message; the JSON says where each array is."""
    at, places = 0, {}
    for name, array in arrays.items():
        places[name] = {"at": at, "shape": array.shape, "type": array.dtype.str}
        at += array.nbytes
    text = json.dumps({**content, "arrays": places}, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    parts = (np.ascontiguousarray(array).tobytes() for array in arrays.values())
    return b"".join((len(text).to_bytes(4, "little"), text, *parts))
