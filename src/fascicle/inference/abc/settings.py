"""Settings of approximate Bayesian computation."""

from __future__ import annotations

from enum import StrEnum

from pydantic import BaseModel, ConfigDict, Field


class CandidateOrder(StrEnum):
    """The order in which candidates from the informed prior are tried."""

    RANDOM = "random"  # as they are drawn: independent draws from the prior
    DENSITY = "density"  # by falling density, as in the paper: the first ones are modes


class AbcSettings(BaseModel):
    """When a candidate is accepted, and how long to look; every field describes itself."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    samples: int = Field(default=30, ge=1, description="Networks to accept.")
    workers: int = Field(
        default=2,  # not the number of cores, so that the same settings give the same result
        ge=1,
        description="Simulations at a time; proposals per step.",
    )
    tolerance: float = Field(
        default=0.9,
        gt=0,
        le=1,
        description="Largest difference of a network's errors, beat by beat, from the best "
        "network's (total variation, 0 to 1).",
    )
    draws: int = Field(
        default=5_000_000, ge=1, description="Uniform draws for the informed prior in each round."
    )
    candidate_order: CandidateOrder = Field(
        default=CandidateOrder.RANDOM,
        description="Order of the candidates; by density, as in the paper, prefers modes.",
    )
    refit_after: int = Field(
        default=50,
        ge=1,
        description="Rejections in a row after which the surrogate is fitted again.",
    )
    rounds: int = Field(
        default=4, ge=1, description="Fits at most; random walks then complete the population."
    )
    walk_steps: int = Field(
        default=100,
        ge=0,
        description="Steps of each walk after the best network last changed; 0: no walks.",
    )
