"""Parameter files: TOML with one line a parameter."""

from __future__ import annotations

import tomllib
from pathlib import Path

from fascicle.core.errors import InputError
from fascicle.core.files import check_file
from fascicle.core.parameters import NETWORK_SPACE, check_names


def read_parameters(path: Path | str) -> dict[str, float]:
    """Read the twelve parameters of a network from a TOML file.

    Raises
    ------
    InputError
        If the file is missing or not TOML, or a parameter is unknown, missing or not finite.
    """
    path = Path(path)
    check_file(path, (".toml",), "parameters")
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:  # of TOML, of UTF-8, of a number too long
        raise InputError(f"{path}: not valid TOML ({error}); write lines like 'cv = 3.0'") from None
    try:
        check_names(values, NETWORK_SPACE.names)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except OverflowError:
        raise InputError(f"{path}: a number has too many digits; correct it") from None
    return {name: float(values[name]) for name in NETWORK_SPACE.names}
