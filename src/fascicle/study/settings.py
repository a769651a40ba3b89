"""All that decides the outcome of a study."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from fascicle.core.parameters import Parameter, ParameterSpace

FORMAT = 1  # of the folder; raised when old studies can no longer be read


class FreeParameter(BaseModel):
    """A parameter that the study learns, with the range it is searched in."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    unit: str
    lower: float
    upper: float


class StudyConfig(BaseModel):
    """All that decides the outcome of a study; two runs with equal ones give equal results.

    Attributes
    ----------
    heart, target : str
        Hashes of the heart and of the target.
    space : tuple of FreeParameter
        What is learnt.
    gain : bool
        Whether a global gain of the simulated ECG is fitted.
    initial, steps, samples : int
        Latin hypercube points, points of the optimisation, posterior samples.
    batch : int
        Points evaluated at once; the optimisation also proposes as many at once.
    draws : int
        Uniform draws for the informed prior, each round.
    candidate_order : {"random", "density"}
        Order in which its draws are tried; "density" is the paper's and finds modes.
    tolerance, patience, rounds
        See `fascicle.inference.abc.rejection.Rules`.
    sweeps : int
        Steps of the random walks that complete the sample; see
        `fascicle.inference.abc.random_walks`.
    seed : int
        Of all random numbers.
    version : int
        Format of the study folder.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    heart: str
    target: str
    space: tuple[FreeParameter, ...] = Field(min_length=1)
    gain: bool = False
    initial: int = Field(default=250, ge=2)
    steps: int = Field(default=300, ge=0)
    refine: int = Field(default=200, ge=0)
    samples: int = Field(default=30, ge=1)
    batch: int = Field(default=1, ge=1)
    draws: int = Field(default=5_000_000, ge=1)
    candidate_order: Literal["random", "density"] = "random"
    tolerance: float = Field(default=0.9, gt=0, le=1)
    patience: int = Field(default=50, ge=1)
    rounds: int = Field(default=4, ge=1)
    sweeps: int = Field(default=100, ge=1)
    seed: int = Field(default=0, ge=0)
    version: int = FORMAT

    @staticmethod
    def free(space: ParameterSpace) -> tuple[FreeParameter, ...]:
        """Make the `space` field for a parameter space."""
        return tuple(
            FreeParameter(name=p.name, unit=p.unit, lower=p.lower, upper=p.upper)
            for p in space.parameters
        )

    def parameter_space(self) -> ParameterSpace:
        """Give the parameter space that is learnt."""
        return ParameterSpace(
            tuple(Parameter(p.name, p.unit, p.lower, p.upper) for p in self.space)
        )
