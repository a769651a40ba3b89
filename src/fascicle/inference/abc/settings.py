"""Settings of approximate Bayesian computation."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class AbcSettings(BaseModel):
    """When a candidate is accepted, and how long to look; every field describes itself."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    samples: int = Field(default=30, ge=1, le=100_000, description="Networks wanted.")
    workers: int = Field(
        default=2,  # not the number of cores, so that the same settings give the same result
        ge=1,
        le=1024,
        description="Simulations at a time.",
    )
    tolerance: float = Field(
        default=0.9,
        gt=0,
        le=1,
        description="Largest difference of a network's errors, beat by beat, from the best "
        "network's (total variation, 0 to 1).",
    )
    draws: int = Field(
        default=5_000_000,
        ge=1,
        le=1_000_000_000,
        description="Uniform draws for the informed prior in each round.",
    )
    refit_after: int = Field(
        default=50,
        ge=1,
        le=1_000_000,
        description="Rejections in a row after which the surrogate is fitted again.",
    )
    rounds: int = Field(
        default=20,
        ge=1,
        le=1_000_000,
        description="Rounds of candidates at most, each after a fit of the surrogate; the paper "
        "has no such limit.",
    )
