"""Options that every command has: how much it says, in which form, and where that is kept."""

from __future__ import annotations

import functools
import inspect
import io
import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer

from fascicle.core.errors import InputError
from fascicle.core.files import outside_allowed
from fascicle.core.progress_lines import duration

PANEL = "Every command"
Result = Mapping[str, Any] | Sequence[Any]  # of a command, for --json
NOT_ALL = 1  # exit status
TOLD = 60.0  # s, from which on a command says at its end how long it took


class NotAllDoneError(Exception):
    """A command has done what it could, which is not all; it ends with exit status 1.

    Parameters
    ----------
    result : mapping or sequence
        What it has done.
    """

    def __init__(self, result: Result) -> None:
        super().__init__("not all is done")
        self.result = result


Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Print nothing but errors.", rich_help_panel=PANEL)
]
AsJson = Annotated[
    bool,
    typer.Option("--json", help="Print the result as JSON, and no words.", rich_help_panel=PANEL),
]
Log = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Add to this file, with times, what is said of the run.",
        rich_help_panel=PANEL,
    ),
]
AllowOutside = Annotated[
    bool,
    typer.Option(
        "--allow-outside",
        help="Read files outside its folder that a file names.",
        rich_help_panel=PANEL,
    ),
]
ADDED = tuple(
    inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
    for name, default, annotation in (
        ("quiet", False, Quiet),
        ("as_json", False, AsJson),
        ("log", None, Log),
        ("allow_outside", False, AllowOutside),
    )
)


@dataclass(frozen=True)
class Output:
    """Where a command says how far it is.

    Attributes
    ----------
    screen : text stream, optional
        The standard error; None where nothing is to be said.
    log : text stream, optional
        A file for all that is said.
    """

    screen: TextIO | None
    log: TextIO | None = None

    def note(self, text: str) -> None:
        """Add a line to the log, with the time."""
        if self.log is not None:
            self.log.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")
            self.log.flush()


_CURRENT: ContextVar[Output | None] = ContextVar("output of the command that runs", default=None)


def current_output() -> Output:
    """Return that of the command that runs."""
    return _CURRENT.get() or Output(sys.stderr)


class _Copied(io.TextIOBase):
    """A stream whose lines go to the log, too."""

    def __init__(self, stream: TextIO | None, output: Output) -> None:
        self._stream, self._output, self._line = stream, output, ""

    def write(self, text: str) -> int:
        if self._stream is not None:
            self._stream.write(text)
        *whole, self._line = (self._line + text).split("\n")
        for line in whole:
            self._output.note(line)
        return len(text)

    def flush(self) -> None:
        if self._stream is not None:
            self._stream.flush()

    def isatty(self) -> bool:
        return self._stream is not None and self._stream.isatty()

    @property
    def encoding(self) -> str:  # type: ignore[override]  # rich asks what can be shown
        return self._stream.encoding if self._stream is not None else "utf-8"


def every_command(command: Callable[..., Result]) -> Callable[..., None]:
    """Give a command the options that every one has, and print its result where JSON is asked for.

    Parameters
    ----------
    command : callable
        Prints its result for people, and returns it for programs.
    """

    @functools.wraps(command)
    def run(
        *given: Any, quiet: bool, as_json: bool, log: Path | None, allow_outside: bool, **named: Any
    ) -> None:
        status, begun = 0, time.monotonic()
        with ExitStack() as around:
            if allow_outside:
                around.enter_context(outside_allowed())
            around.enter_context(_saying(quiet, as_json, log))
            try:
                result = command(*given, **named)
            except NotAllDoneError as ended:
                result, status = ended.result, NOT_ALL
            taken = time.monotonic() - begun
            if taken >= TOLD:
                print(f"took {duration(taken)}", file=sys.stderr)
        if as_json:
            print(json.dumps(_plain(result), indent=2))
        if status:
            raise typer.Exit(status)

    signature = inspect.signature(command, eval_str=True)
    parameters = [*signature.parameters.values(), *ADDED]
    run.__annotations__ = {p.name: p.annotation for p in parameters}  # what Typer looks at
    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return run


@contextmanager
def _saying(quiet: bool, as_json: bool, log: Path | None) -> Iterator[None]:
    """Send what is printed in the block where the options say."""
    with ExitStack() as around:
        file = around.enter_context(_opened(log)) if log is not None else None
        output = Output(None if quiet else sys.stderr, file)
        output.note(" ".join(["fascicle", *sys.argv[1:]]))
        words = None if quiet or as_json else sys.stdout
        around.enter_context(redirect_stdout(_Copied(words, output)))
        around.enter_context(redirect_stderr(_Copied(output.screen, output)))
        token = _CURRENT.set(output)
        try:
            yield
        except InputError as error:
            output.note(f"error: {error}")
            raise
        except KeyboardInterrupt:
            output.note("interrupted")
            raise
        finally:
            _CURRENT.reset(token)


def _opened(log: Path) -> TextIO:
    try:
        return log.open("a", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{log}: {error.strerror}; give another --log") from None


def _plain(value: Any) -> Any:
    """The same in what JSON has: numbers of NumPy as numbers, what is not finite as null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, str | bool | int) or value is None:
        return value
    if hasattr(value, "tolist"):  # arrays and scalars of NumPy
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return [_plain(item) for item in value]
