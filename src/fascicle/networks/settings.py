"""Settings of a fit; the module imports little, since the command line makes options of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fascicle.core.errors import InputError
from fascicle.core.ranges import did_you_mean, shown

Method = Literal["posterior", "paper"]
# Settings that only one of the methods has
SETTINGS_OF: dict[Method, tuple[str, ...]] = {
    "posterior": ("effective", "prior_simulations", "gain_sd"),
    "paper": (
        "samples", "tolerance", "draws", "refit_after", "rounds", "initial", "steps", "refit_every",
        "leads", "free_gain",
    ),
}  # fmt: skip


def _whole(default: int, least: int, most: int, description: str) -> Any:
    return Field(default, ge=least, le=most, description=description)


class FitSettings(BaseModel):
    """The settings of `fascicle.fit`, and the options of ``fascicle fit``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    samples: int = _whole(30, 1, 100_000, "Networks wanted.")
    workers: int | None = Field(
        None,
        ge=1,
        le=1024,
        description="Simulations at a time; by default one per core, and 2 by the paper's method, "
        "whose result depends on it.",
    )
    tolerance: float = Field(
        0.9,
        gt=0,
        le=1,
        description="Largest difference of a network's errors, beat by beat, from the best "
        "network's (total variation, 0 to 1).",
    )
    draws: int = _whole(
        5_000_000, 1, 1_000_000_000, "Uniform draws for the informed prior in each round."
    )
    refit_after: int = _whole(
        50, 1, 1_000_000, "Rejections in a row after which the surrogate is fitted again."
    )
    rounds: int = _whole(
        20,
        1,
        1_000_000,
        "Rounds of candidates at most, each after a fit of the surrogate; the paper has no such "
        "limit.",
    )
    initial: int = _whole(250, 2, 100_000, "Latin hypercube points.")
    steps: int = _whole(300, 0, 100_000, "Bayesian-optimisation steps.")
    refit_every: int = _whole(
        10,
        1,
        100_000,
        "Steps after which the surrogate's hyper-parameters are fitted again; in the paper at "
        "every step (1). It knows every evaluation at once.",
    )
    effective: int = _whole(
        300, 20, 100_000, "Networks to simulate, and effective sample size to reach."
    )
    prior_simulations: int = _whole(
        2000,
        100,
        1_000_000,
        "Networks of the prior from which the emulator learns, after hearts of the population. "
        "They are made once for all recordings of a heart.",
    )
    gain_sd: float = Field(
        0.3,
        ge=0,
        le=3,
        description="Standard deviation of the gain of the simulated ECG about 1; 0 fixes it.",
    )
    method: Method = Field(
        "posterior",
        description="'paper': what the paper does and nothing else, with the speed constant alpha "
        "fixed; it gives a population of networks, not a posterior. 'posterior' has priors of "
        "human anatomy, and learns the speed along the fibre, too.",
    )
    leads: Literal["12", "8"] = Field(
        "12",
        description="Leads that are compared: all 12, as in the paper, or the 8 independent ones; "
        "and the additional ones that heart and recording share.",
    )
    fewest_junctions: int = _whole(
        0, 0, 100_000, "A network with a tree of fewer junctions does not count as one."
    )
    seed: int = _whole(0, 0, 2**63 - 1, "Of all random numbers.")
    free_gain: bool = Field(
        False,
        description="Scale each simulated ECG by its best gain, one for all leads, before it is "
        "compared.",
    )

    @property
    def batch(self) -> int:
        """Simulations at a time."""
        from fascicle.core.threads import cores  # slow to import, and only a fit needs it

        return self.workers or (2 if self.method == "paper" else cores())

    def __init__(self, **settings: Any) -> None:
        try:
            super().__init__(**settings)
        except ValidationError as error:
            name, value, message = first_problem(error)
            if name not in type(self).model_fields:
                advice = "give quantities as parameters, and the person to load_heart"
                advice = did_you_mean(name, type(self).model_fields) or advice
                raise InputError(f"'{name}' is no setting of a fit; {advice}") from None
            raise InputError(f"'{name}' is {shown(value)}: {message.lower()}") from None


# For `help`: what the fields say of themselves.
FitSettings.__doc__ = "\n".join(
    [f"{FitSettings.__doc__}", "", "    Attributes", "    ----------"]
    + [
        f"    {name} : default {field.default}\n        {field.description}"
        for name, field in FitSettings.model_fields.items()
    ]
)


def checked_settings(values: Mapping[str, Any]) -> FitSettings:
    """Check settings; impossible, unknown and unused settings are refused in one line."""
    settings = FitSettings(**values)
    other = SETTINGS_OF["posterior" if settings.method == "paper" else "paper"]
    foreign = [name for name in other if name in values]
    if foreign:
        raise InputError(
            f"'{foreign[0]}' is {shown(values[foreign[0]])}: the method '{settings.method}' has no "
            "such setting; leave it out, or choose the other method"
        )
    return settings


def first_problem(error: ValidationError) -> tuple[str, Any, str]:
    """Name, value and error message of the first setting that was refused."""
    first = error.errors()[0]
    return ".".join(map(str, first["loc"])), first["input"], first["msg"]
