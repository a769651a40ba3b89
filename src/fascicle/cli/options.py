"""Arguments and options that several commands share, and how their text is read."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import typer
from typer import Argument, Option

import fascicle
from fascicle.core.errors import InputError, check_installed, given_in
from fascicle.core.files import check_folder, check_replaceable
from fascicle.core.progress import Progress
from fascicle.networks.settings import FitSettings
from fascicle.prediction.index_names import COMPARED, INDICES

HeartArgument = Annotated[
    str,
    Argument(
        metavar="HEART",
        help="Heart folder, or one of the package: camps-dti004, default, or atlas, hearts of the "
        "population for a person of whom there is no image.",
    ),
]
SexOption = Annotated[
    Literal["f", "m"] | None,
    Option(help="Of the person, for the heart 'atlas'.", show_default=False),
]
AgeOption = Annotated[float | None, Option(help="Of the person (years), for 'atlas'.")]
HeightOption = Annotated[float | None, Option(help="Of the person (cm), for 'atlas'.")]
WeightOption = Annotated[float | None, Option(help="Of the person (kg), for 'atlas'.")]
StudyArgument = Annotated[Path, Argument(help="Finished study folder.")]


def free_folder(path: Path) -> Path:
    """A folder that can be written, refused while arguments are read, before any work."""
    check_folder(path)
    return path


def free_file(option: typer.CallbackParam, path: Path | None) -> Path | None:
    """A file that can be written, refused while arguments are read, before any work."""
    if path is not None:
        check_replaceable(path, option.opts[0])
    return path


OutOption = Annotated[Path, Option("--out", help="Folder to write.", callback=free_folder)]
FormatOption = Annotated[Literal["png", "svg", "pdf"], Option("--format", help="Picture format.")]
WorkersOption = Annotated[
    int | None, Option("--workers", min=1, help="Simulations at a time; by default one per core.")
]
SchedulerOption = Annotated[
    str | None,
    Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Dask scheduler, such as tcp://10.0.0.1:8786, whose workers simulate "
        "('fascicle docs cluster'); by default the cores of this machine do.",
    ),
]
IndexOption = Annotated[
    str,
    Option(
        help="Index that is compared or drawn; less is better: "
        f"{', '.join(f'{name} ({INDICES[name]})' for name in COMPARED)}."
    ),
]
FixOption = Annotated[
    list[str] | None, Option("--fix", help="Quantity to fix, NAME=VALUE, such as alpha=0.08.")
]
FreeOption = Annotated[
    list[str] | None,
    Option(
        "--free",
        help="Quantity to learn, with its default prior, such as gain; or a group: pose, "
        "electrodes or conductivities.",
    ),
]

Command = TypeVar("Command", bound=Callable[..., Any])


def lead_names(text: str) -> list[str]:
    """Leads of a list such as ``I,II,V1-V6,V7-V9,X-Z,E1-E64``; the last are names of the user's."""
    from fascicle.core.leads import ADDITIONAL_LEADS, LEADS
    from fascicle.recording.readers.names import additional_lead_name, lead_name

    standard, leads = [*LEADS, *ADDITIONAL_LEADS], dict[str, None]()
    for part in map(str.strip, text.split(",")):
        ends = [lead_name(end) or additional_lead_name(end) for end in part.split("-")]
        places = [standard.index(end) for end in ends if end is not None]
        numbered = re.fullmatch(r"(\D*)(\d{1,3})(?:-\1(\d{1,3}))?", part)
        if len(places) == len(ends) <= 2 and places == sorted(places):
            leads |= dict.fromkeys(standard[places[0] : places[-1] + 1])
        elif numbered and not places and int(numbered[2]) <= int(numbered[3] or numbered[2]):
            numbers = range(int(numbered[2]), int(numbered[3] or numbered[2]) + 1)
            leads |= dict.fromkeys(f"{numbered[1]}{number}" for number in numbers)
        else:
            raise InputError(
                f"leads '{part}': give one, or the first and the last; leads are "
                f"{', '.join(standard)}, and numbered ones such as E1-E64"
            )
    return [*leads]


def option(
    name: str, kind: Any, default: Any, *flags: str, panel: str | None, **shown: Any
) -> inspect.Parameter:
    """Describe an option, in a panel of the help, as a parameter of a command."""
    annotation = Annotated[kind, Option(*flags, rich_help_panel=panel, **shown)]
    by_keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, by_keyword, default=default, annotation=annotation)


def with_options(command: Command, options: Sequence[inspect.Parameter]) -> Command:
    """Give a command more options, in place of its `**named` arguments if it has them."""
    parameters = [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for parameter in inspect.signature(command, eval_str=True).parameters.values()
        if parameter.kind is not inspect.Parameter.VAR_KEYWORD
    ]
    parameters += options
    command.__annotations__ = {p.name: p.annotation for p in parameters}  # Typer reads these
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return command


def fit_options(command: Command) -> Command:
    """Give a command an option for every field of `FitSettings`, with its text and limits."""
    first = (
        "method", "effective", "prior_simulations", "gain_sd", "seed", "workers",
        "fewest_junctions",
    )  # fmt: skip
    options = []
    for name in (*first, *(name for name in FitSettings.model_fields if name not in first)):
        field = FitSettings.model_fields[name]
        flags = ["--" + name.replace("_", "-"), *(["--gain"] if name == "free_gain" else [])]
        ends = {
            end: getattr(limit, kind)
            for limit in field.metadata
            for kind, end in (("ge", "min"), ("le", "max"))
            if hasattr(limit, kind)
        }
        panel = None if name in first else "The paper's method"
        shown = {"panel": panel, "help": field.description, **ends}
        options.append(option(name, field.annotation, field.default, *flags, **shown))
    return with_options(command, options)


def explicit(context: typer.Context, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings given on the command line; the others may come from a settings file."""
    sources = {name: context.get_parameter_source(name) for name in settings}
    default = "DEFAULT"  # member of a private Enum of Typer
    return {n: settings[n] for n, source in sources.items() if source and source.name != default}


def with_scenario(text: str) -> Path | tuple[Path, Path]:
    """A target, or target and scenario of ``target.nc:scenario``, of the library or a file."""
    target, _, scenario = text.rpartition(":")
    named = (target.endswith(".nc") and scenario) or scenario.endswith(".toml")
    if not target or not named or Path(text).exists():
        return Path(text)
    return Path(target), Path(scenario)


def pool_at(scheduler: str | None, progress: Progress) -> fascicle.Cluster | None:
    """Workers of the Dask scheduler at an address; None without an address."""
    if scheduler is None:
        return None
    check_installed("distributed", "--scheduler", "cluster")
    return fascicle.Cluster(scheduler, progress)


def fixed_values(fix: Sequence[str] | None, **named: float | None) -> dict[str, float]:
    """Read items such as 'alpha=0.08', and options that have the name of a quantity."""
    from fascicle.core.quantities import QUANTITIES, checked

    items: list[tuple[str, str, Any]] = [
        (f"--{n.replace('_', '-')}", n, v) for n, v in named.items() if v is not None
    ]
    for item in fix or ():
        name, value = (part.strip() for part in (*item.split("=", 1), "")[:2])
        try:
            items.append((f"--fix {item}", name, float(value)))
        except ValueError:
            if not (name in QUANTITIES and QUANTITIES[name].choices):
                needed = "not a name and a number; write it like alpha=0.08"
                raise InputError(f"--fix {item}: {needed}") from None
            items.append((f"--fix {item}", name, value))
    values: dict[str, float] = {}
    for option, name, value in items:
        if name in values:
            raise InputError(f"{option}: '{name}' is given twice; give it once")
        with given_in(option):
            values |= checked({name: value})
    return values


def wanted_parameters(free: Sequence[str] | None, fix: Sequence[str] | None) -> dict[str, object]:
    """The argument `parameters` of `fascicle.fit`, from --free and --fix."""
    from fascicle.core.parameters import FREE

    fixed = fixed_values(fix)
    for name in free or ():
        if name in fixed:
            raise InputError(f"--free {name}: it is fixed as well; give either --free or --fix")
    return {**dict.fromkeys(free or (), FREE), **fixed}
