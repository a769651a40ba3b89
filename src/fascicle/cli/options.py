"""Arguments and options that several commands share, and how their text is read."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer
from pydantic import BaseModel

from fascicle.core.errors import InputError, given_in
from fascicle.core.progress import Progress
from fascicle.prediction.index_names import COMPARED, INDICES

if TYPE_CHECKING:
    from fascicle.study.cluster import Cluster

HeartArgument = Annotated[
    str, typer.Argument(metavar="HEART", help="Heart folder, or 'default' for the packaged one.")
]
StudyArgument = Annotated[Path, typer.Argument(help="Finished study folder.")]
OutOption = Annotated[Path, typer.Option("--out", help="Folder to write.")]
FormatOption = Annotated[
    Literal["png", "svg", "pdf"], typer.Option("--format", help="Of the pictures.")
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Of a Dask scheduler, such as tcp://10.0.0.1:8786, whose workers simulate "
        "(docs/cluster.md); else the cores of this machine do.",
    ),
]
IndexOption = Annotated[
    str,
    typer.Option(
        help="Index that is compared or drawn; less is better: "
        f"{', '.join(f'{name} ({INDICES[name]})' for name in COMPARED)}."
    ),
]
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

Command = TypeVar("Command", bound=Callable[..., Any])


def settings_options(
    settings: type[BaseModel], first: Sequence[str], panel: str, also: Mapping[str, str]
) -> Callable[[Command], Command]:
    """Give a command an option for every field of some settings, in place of its `**settings`.

    Name, type, default, range and help are those of the field.

    Parameters
    ----------
    settings : pydantic model
        Whose fields become options.
    first : sequence of str
        Fields that stand among the other options of the command.
    panel : str
        Panel of the help that holds the rest.
    also : mapping of str to str
        Second names of options, by field.
    """

    def option(name: str) -> inspect.Parameter:
        field = settings.model_fields[name]
        names = ["--" + name.replace("_", "-"), *([also[name]] if name in also else [])]
        ends = {
            option: getattr(limit, kind)
            for limit in field.metadata
            for kind, option in (("ge", "min"), ("le", "max"))
            if hasattr(limit, kind)
        }
        where = None if name in first else panel
        shown = typer.Option(*names, **ends, help=field.description, rich_help_panel=where)
        return inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=field.default,
            annotation=Annotated[field.annotation, shown],
        )

    def decorate(command: Command) -> Command:
        signature = inspect.signature(command, eval_str=True)
        own = [
            parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
            for parameter in signature.parameters.values()
            if parameter.kind is not inspect.Parameter.VAR_KEYWORD
        ]
        rest = [name for name in settings.model_fields if name not in first]
        parameters = own + [option(name) for name in (*first, *rest)]
        # what Typer looks at
        command.__annotations__ = {p.name: p.annotation for p in parameters}
        command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        return command

    return decorate


def explicit(context: typer.Context, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Those of a command's settings that the user has given; the rest may come otherwise."""
    sources = {name: context.get_parameter_source(name) for name in settings}
    default = "DEFAULT"  # of an Enum that Typer keeps to itself
    return {n: settings[n] for n, source in sources.items() if source and source.name != default}


def with_scenario(text: str) -> Path | tuple[Path, Path]:
    """A target, or target and scenario of ``target.nc:scenario.toml``."""
    target, colon, scenario = text.rpartition(":")
    if not colon or not scenario.endswith(".toml") or Path(text).exists():
        return Path(text)
    return Path(target), Path(scenario)


def pool_at(scheduler: str | None, progress: Progress) -> Cluster | None:
    """Workers of the Dask scheduler at an address; none where no address is given."""
    if scheduler is None:
        return None
    if find_spec("distributed") is None:
        raise InputError("--scheduler needs Dask; install it: pip install distributed")
    from fascicle.study.cluster import Cluster

    return Cluster(scheduler, progress)


def fixed_values(fix: Sequence[str] | None, **named: float | None) -> dict[str, float]:
    """Read items such as 'alpha=0.08', and values of options that are named as their quantity."""
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
