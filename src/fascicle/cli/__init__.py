"""The command line: one line and status 2 for a wrong input, 130 for Ctrl-C."""

from __future__ import annotations

import errno
import sys
from typing import NoReturn

from fascicle.cli.interruption import ended_promptly
from fascicle.core.errors import InputError


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
