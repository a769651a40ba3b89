"""What is damaged, and what then reads it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.fuzzing import seeds
from benchmarks.fuzzing.seeds import Seed


@dataclass(frozen=True)
class Kind:
    """Files of one kind.

    Attributes
    ----------
    seeds : function
        Makes whole ones.
    read : function
        Of the path of what is read; anything it raises but InputError is a failure.
    """

    seeds: Callable[[], list[Seed]]
    read: Callable[[Path], Any]


def _mesh(path: Path) -> Any:
    from fascicle.mesh.formats.read import read_mesh

    return read_mesh(path)


def _segmentation(path: Path) -> Any:
    from fascicle.build.segmentation.files import read_segmentation

    return read_segmentation(path)


def _recording(path: Path) -> Any:
    from fascicle import read_recording

    return read_recording(path)


def _heart(path: Path) -> Any:
    from fascicle import load_heart

    return load_heart(path)


KINDS = {
    "meshes": Kind(seeds.meshes, _mesh),
    "segmentations": Kind(seeds.segmentations, _segmentation),
    "hearts": Kind(seeds.hearts, _heart),
    "recordings": Kind(seeds.recordings, _recording),
}
