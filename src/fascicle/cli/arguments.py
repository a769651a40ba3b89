"""Arguments that several commands share, and options made of settings."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from fascicle.core.errors import InputError
from fascicle.core.progress import Progress
from fascicle.prediction.index_names import COMPARED, INDICES

if TYPE_CHECKING:
    from fascicle.study.cluster import Cluster

HeartArgument = Annotated[
    str, typer.Argument(metavar="HEART", help="Heart folder, or 'default' for the packaged one.")
]
OutOption = Annotated[Path, typer.Option("--out", help="Folder to write.")]
StudyArgument = Annotated[Path, typer.Argument(help="Finished study folder.")]

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
INDEX_NAMES = ", ".join(f"{name} ({INDICES[name]})" for name in COMPARED)  # for help

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
    rest = [name for name in settings.model_fields if name not in first]

    def decorate(command: Command) -> Command:
        signature = inspect.signature(command, eval_str=True)
        parameters = [
            parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
            for parameter in signature.parameters.values()
            if parameter.kind is not inspect.Parameter.VAR_KEYWORD
        ]
        for name in (*first, *rest):
            names = ["--" + name.replace("_", "-"), *([also[name]] if name in also else [])]
            option = _option(settings.model_fields[name], names, panel if name in rest else None)
            parameters.append(option.replace(name=name))
        # what Typer looks at
        command.__annotations__ = {p.name: p.annotation for p in parameters}
        command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        return command

    return decorate


def explicit(context: typer.Context, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Those of a command's settings that the user has given, so that the rest may come otherwise.

    Parameters
    ----------
    context : typer.Context
        Of the command.
    settings : mapping
        Its settings, by name.
    """
    sources = {name: context.get_parameter_source(name) for name in settings}
    default = "DEFAULT"  # of an Enum that Typer keeps to itself
    return {n: settings[n] for n, source in sources.items() if source and source.name != default}


def _option(field: FieldInfo, names: Sequence[str], panel: str | None) -> inspect.Parameter:
    """A command's parameter for one field; the caller names it."""

    def limit(kind: str) -> Any:
        return next((getattr(m, kind) for m in field.metadata if hasattr(m, kind)), None)

    option = typer.Option(
        *names, min=limit("ge"), max=limit("le"), help=field.description, rich_help_panel=panel
    )
    return inspect.Parameter(
        "_",
        inspect.Parameter.KEYWORD_ONLY,
        default=field.default,
        annotation=Annotated[field.annotation, option],
    )


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
