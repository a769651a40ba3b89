"""Arguments that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

HeartArgument = Annotated[
    str, typer.Argument(metavar="HEART", help="Heart folder, or 'default' for the packaged one.")
]
OutOption = Annotated[Path, typer.Option("--out", help="Folder to write.")]
