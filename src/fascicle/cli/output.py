"""Options that every command has, where its output goes, and the progress of long runs."""

from __future__ import annotations

import functools
import io
import json
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import typer
from pydantic_core import to_jsonable_python

from fascicle.cli.options import option, with_options
from fascicle.core.errors import InputError, OutputError
from fascicle.core.files import outside_allowed
from fascicle.core.progress import ProgressLines, duration, time_left, write_with_time

if TYPE_CHECKING:
    from rich.progress import Progress as Bars

Result = Mapping[str, Any] | Sequence[Any]  # result of a command, for --json


class NotAllDoneError(Exception):
    """Part of a command has failed: the rest, `result`, is printed and the exit status is 1."""

    def __init__(self, result: Result) -> None:
        super().__init__("not all is done")
        self.result = result


def every_command(command: Callable[..., Result]) -> Callable[..., None]:
    """Give a command the options of every command, and print its result as JSON for --json.

    The command prints its result for people, and returns it for programs.
    """

    @functools.wraps(command)
    def run(
        quiet: bool, as_json: bool, log: Path | None, allow_outside: bool, **arguments: Any
    ) -> None:
        status, begun = 0, time.monotonic()
        with ExitStack() as around:
            if allow_outside:
                around.enter_context(outside_allowed())
            around.enter_context(_redirected(quiet, as_json, log))
            try:
                result = command(**arguments)
            except NotAllDoneError as ended:
                result, status = ended.result, 1
            elapsed = time.monotonic() - begun
            if elapsed >= 60.0:
                print(f"took {duration(elapsed)}", file=sys.stderr)
        if as_json:
            print(_as_json(result))
        if status:
            raise typer.Exit(status)

    of_all = functools.partial(option, panel="Every command")
    options = [
        of_all("quiet", bool, False, "--quiet", "-q", help="Print nothing but errors."),
        of_all("as_json", bool, False, "--json", help="Print the result as JSON and nothing else."),
        of_all(
            "log", Path | None, None, metavar="FILE",
            help="Append all messages to this file, with times.",
        ),
        of_all(
            "allow_outside", bool, False, "--allow-outside",
            help="Let files name files outside their own folder.",
        ),
    ]  # fmt: skip
    return with_options(run, options)


def print_row(label: str, text: object) -> None:
    """Print a line of a result: its name and its text."""
    print(f"{label:<22} {text}")


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Print texts in columns, each as wide as its longest text."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print("  ".join(f"{text:<{n}}" for text, n in zip(row, widths, strict=True)).rstrip())


@dataclass(frozen=True)
class Output:
    """Destinations of progress: standard error unless the command is quiet, and a log."""

    screen: TextIO | None
    log: TextIO | None = None

    def note(self, text: str) -> None:
        """Add a line to the log, with the time."""
        if self.log is not None:
            text = re.sub(r"(http://127\.0\.0\.1:\d+/)\S+", r"\1…", text)  # a token is secret
            self.log.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")
            self.log.flush()


_output: ContextVar[Output | None] = ContextVar("output of the command that runs", default=None)


@contextmanager
def _redirected(quiet: bool, as_json: bool, log: Path | None) -> Iterator[None]:
    """Send what the block prints to the screen and to the log, as the options say."""
    with ExitStack() as around:
        file = None
        if log is not None:
            begins = log.read_text(errors="replace")[:11] if log.is_file() else ""
            if begins and not re.match(r"\d{4}-\d\d-\d\d ", begins):
                raise OutputError(f"{log}: exists, and is no log of fascicle; give another --log")
            try:
                file = around.enter_context(log.open("a", encoding="utf-8"))
            except OSError as error:
                raise OutputError(f"{log}: {error.strerror}; give another --log") from None
        output = Output(None if quiet else sys.stderr, file)
        output.note(" ".join(["fascicle", *sys.argv[1:]]))
        words = None if quiet or as_json else sys.stdout
        around.enter_context(redirect_stdout(_Copied(words, output)))
        around.enter_context(redirect_stderr(_Copied(output.screen, output)))
        token = _output.set(output)
        try:
            yield
        except InputError as error:
            output.note(f"error: {error}")
            raise
        except KeyboardInterrupt:
            output.note("interrupted")
            raise
        finally:
            _output.reset(token)


class _Copied(io.TextIOBase):
    """Stream whose lines are copied to the log."""

    def __init__(self, stream: TextIO | None, output: Output) -> None:
        self._stream, self._output, self._line = stream, output, ""

    def write(self, text: str) -> int:
        if self._stream is not None:
            self._stream.write(text)
        *complete_lines, self._line = (self._line + text).split("\n")
        for line in complete_lines:
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


def _as_json(result: Result) -> str:
    """JSON of a result, with NumPy's numbers; those that are not finite are null."""
    plain = to_jsonable_python(result, inf_nan_mode="null", fallback=lambda array: array.tolist())
    return json.dumps(plain, indent=2)


class TerminalProgress(ProgressLines):
    """Progress of a command: a bar a stage in a terminal; lines elsewhere, and in the log."""

    def __init__(self, output: Output | None = None) -> None:
        self._output = output or _output.get() or Output(sys.stderr)
        super().__init__(self._write)

    def _make_bars(self) -> Bars:
        from rich import progress
        from rich.console import Console
        from rich.text import Text

        class TimeLeft(progress.ProgressColumn):
            def render(self, task: progress.Task) -> Text:
                return Text(time_left(task), style="progress.remaining")

        screen = self._output.screen
        console = Console(file=screen, stderr=True, quiet=screen is None)
        return progress.Progress(
            progress.TextColumn("{task.description:<24}"),
            progress.BarColumn(bar_width=30),
            progress.MofNCompleteColumn(),
            progress.TimeElapsedColumn(),
            TimeLeft(),
            progress.TextColumn("{task.fields[message]}"),
            console=console,
            speed_estimate_period=60.0,
            disable=not console.is_terminal,
        )

    def _write(self, line: str) -> None:
        """Add a line to the log, and to a screen that is not a terminal."""
        self._output.note(line)
        screen = self._output.screen
        if screen is not None and not screen.isatty():
            write_with_time(line, screen)

    def __enter__(self) -> TerminalProgress:
        return self  # the bars start with the first stage, so that an early error stands alone

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self.end(clear=isinstance(error, InputError))  # a refusal stands alone, in one line
