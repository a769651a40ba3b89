"""The one error type that a user is meant to see."""

from __future__ import annotations


class InputError(ValueError):
    """Something the user gave cannot be used.

    The message is one line that names the file, the thing, the value found and what to do. The
    command line prints it and exits with status 2. Anything else that is raised is a bug.
    """
