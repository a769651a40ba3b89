"""`fascicle parameters`, and options that name quantities of the model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import typer

from fascicle.cli.output import Result
from fascicle.core.errors import InputError, given_in

FixOption = Annotated[
    list[str] | None,
    typer.Option("--fix", help="Quantity at a value, NAME=VALUE, such as alpha=0.08."),
]
FreeOption = Annotated[
    list[str] | None,
    typer.Option(
        "--free",
        help="Quantity to learn, with its usual prior, such as gain; or a group of them: pose, "
        "electrodes or conductivities.",
    ),
]


def fixed_values(fix: Sequence[str] | None, **named: float | None) -> dict[str, float]:
    """Read items such as 'alpha=0.08', and options that name a quantity themselves.

    Parameters
    ----------
    fix : sequence of str, optional
        What was given with --fix.
    **named : float, optional
        Values of other options, by the name of their quantity.
    """
    from fascicle.core.quantities import checked

    items = [(f"--{n.replace('_', '-')}", n, v) for n, v in named.items() if v is not None]
    for item in fix or ():
        name, _, number = item.partition("=")
        try:
            items.append((f"--fix {item}", name.strip(), float(number)))
        except ValueError:
            raise InputError(
                f"--fix {item}: not a name and a number; write it like alpha=0.08"
            ) from None
    values: dict[str, float] = {}
    for option, name, value in items:
        if name in values:
            raise InputError(f"{option}: '{name}' is given twice; give it once")
        with given_in(option):
            values |= checked({name: value})
    return values


def wanted_parameters(free: Sequence[str] | None, fix: Sequence[str] | None) -> dict[str, object]:
    """What the options say of each quantity, for `fascicle.fit`."""
    from fascicle.study.space import FREE

    fixed = fixed_values(fix)
    for name in free or ():
        if name in fixed:
            raise InputError(f"--free {name}: it is fixed as well; give one of the two")
    return {**dict.fromkeys(free or (), FREE), **fixed}


def parameters() -> Result:
    """List every quantity of the model: unit, default, range that is searched, meaning.

    Any of them can be fixed in `simulate` and `fit` (--fix NAME=VALUE), and learnt (--free NAME)
    but for those that count something. A heart's own values stand in its heart.toml.
    """
    import rich
    from rich.table import Table

    from fascicle.core.quantities import GROUPS, QUANTITIES, quantity

    table = Table(box=None, pad_edge=False)
    table.add_column("name", overflow="fold", no_wrap=True)
    for heading in ("unit", "default", "prior range", "meaning"):
        table.add_column(heading, overflow="fold")
    shown = [known for name, known in QUANTITIES.items() if not _repeats(name)]
    for known in (*shown, quantity("region_1_conductivity")):
        low, high = known.prior_range
        table.add_row(
            known.name,
            known.unit,
            "" if known.default is None else f"{known.default:g}",
            "" if known.is_integer else f"{low:.3g} to {high:.3g}",
            known.meaning,
        )
    rich.print(table)
    print("Groups that can be freed together (--free NAME): " + ", ".join(GROUPS))
    print("Fascicles are numbered 1 to at most 4; regions by their labels.")
    return [
        {
            "name": known.name,
            "unit": known.unit,
            "default": known.default,
            "prior_range": None if known.is_integer else known.prior_range,
            "meaning": known.meaning,
        }
        for known in QUANTITIES.values()
    ]


def _repeats(name: str) -> bool:
    """Whether a quantity says of another fascicle what the table says of the first."""
    return "_fascicle_" in name and not name.endswith("_1")
