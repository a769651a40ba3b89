"""The command line: one line and status 2 for a wrong input, 130 for Ctrl-C.

Ctrl-C and SIGTERM end the program within two seconds, with nothing half-written. Python handles a
signal only between two of its instructions, which may be minutes away while compiled code runs. A
thread sees the signal at once, and ends the process if it does not end by itself.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import ClassVar, NoReturn

from fascicle.core.errors import InputError
from fascicle.core.files import remove_unfinished


class Terminated(SystemExit):
    """End of the program at SIGTERM."""


@dataclass
class Interruption:
    """Signal that asked the program to end, if any, and whether it has ended by itself."""

    advice: ClassVar[str] = ""  # to print at the end, from `resumable`
    number: int | None = None
    grace: float = 1.5  # s in which the process may end by itself
    over: threading.Event = field(default_factory=threading.Event)

    @property
    def status(self) -> int:
        """Exit status by the convention of shells."""
        return 128 + (signal.SIGINT if self.number is None else self.number)

    def end(self, number: int, frame: FrameType | None) -> NoReturn:
        """Raise in the main thread, so that temporary files are removed."""
        self.number = number
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        raise Terminated(self.status)

    def watch(self, reader: int) -> None:
        """End the process `grace` after a signal whose number comes through a pipe."""
        while (number := os.read(reader, 1)) != b"":
            if number[0] in (signal.SIGINT, signal.SIGTERM) and not self.over.wait(self.grace):
                remove_unfinished()
                os.write(2, self.advice.encode())  # not `sys.stderr`, which may be redirected
                os._exit(128 + number[0])


@contextmanager
def ended_promptly() -> Iterator[Interruption]:
    """End the process within two seconds of a signal that arrives while the block runs.

    Where Ctrl-C is ignored, as in a shell's background job, it stays so.
    """
    interruption = Interruption()
    numbers = [signal.SIGTERM]
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        numbers.append(signal.SIGINT)
    before = {number: signal.signal(number, interruption.end) for number in numbers}
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    woken = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    thread = threading.Thread(target=interruption.watch, args=(reader,), daemon=True)
    thread.start()
    try:
        yield interruption
    finally:
        interruption.over.set()
        signal.set_wakeup_fd(woken)
        for number, handler in before.items():
            signal.signal(number, handler)
        os.close(writer)
        thread.join()
        os.close(reader)


@contextmanager
def resumable(out: Path) -> Iterator[None]:
    """On Ctrl-C or SIGTERM, report that simulations are in `out`, and how to go on."""
    Interruption.advice = (
        f"interrupted; simulations are stored in {out}; run the same command again to resume\n"
    )
    try:
        yield
    except (KeyboardInterrupt, Terminated) as ended:
        print(Interruption.advice, end="", file=sys.stderr)
        sys.exit(ended.code if isinstance(ended, Terminated) else 128 + signal.SIGINT)
    finally:
        Interruption.advice = ""


def main() -> None:
    """Run the command line; a wrong input ends in one line and exit status 2."""
    with ended_promptly() as interruption:
        InputError.names_options = True
        try:
            from fascicle.cli.commands import app

            app()
        except KeyboardInterrupt:  # before there was a command
            sys.exit(interruption.status)
        except (SystemError, RuntimeError):  # so libraries may call an interrupt in a callback
            if interruption.number is None:
                raise
            sys.exit(interruption.status)
        except InputError as error:
            _fail(str(error))
        except OSError as error:
            if error.errno == errno.ENOSPC:
                _fail("no space left on the disk; free some, or give another --out")
            if error.filename is None:  # not about a file that the user named: a bug, to be seen
                raise
            _fail(f"{error.filename}: {error.strerror}; check the path")
        finally:
            InputError.names_options = False


def _fail(message: str) -> NoReturn:
    print("error: " + " ".join(message.split()), file=sys.stderr)
    sys.exit(2)
