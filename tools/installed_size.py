"""Disk space of a plain install: fascicle and all that it needs, without extras.

    python tools/installed_size.py

Sums the files of every distribution that `pip install .` would bring, found by walking the
requirements of those installed here, and lists the largest, with the extra `build` and without. It
fails if an install without it takes 1 GB or more, or brings PyTorch, which on Linux may bring
gigabytes of CUDA packages.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution

from packaging.requirements import Requirement

UNWANTED = "torch"
LISTED = 12  # of the largest
MEGABYTE = 1e6
MOST = 1000  # MB


def needed(name: str, extra: str) -> dict[str, Distribution]:
    """Distributions that a package needs with an extra, itself included, by normalised name."""
    distributions: dict[str, Distribution] = {}
    names = [name, *required(distribution(name), extra)]
    while names:
        current = names.pop()
        key = re.sub(r"[-_.]+", "-", current).lower()
        if key in distributions:
            continue
        try:
            distributions[key] = distribution(current)
        except PackageNotFoundError:
            sys.exit(f"{current} is not installed; run pip install . first")
        names += required(distributions[key])
    return distributions


def required(package: Distribution, extra: str = "") -> Iterator[str]:
    for requirement in map(Requirement, package.requires or []):
        if requirement.marker is None or requirement.marker.evaluate({"extra": extra}):
            yield requirement.name


def size(package: Distribution) -> float:
    """Size of a distribution's files (MB)."""
    paths = {path.locate() for path in package.files or []}
    return sum(path.stat().st_size for path in paths if path.is_file()) / MEGABYTE


def main() -> None:
    for extra in ("build", ""):
        sizes = {name: size(package) for name, package in needed("fascicle-ecg", extra).items()}
        print(f"with the extra `{extra}`:" if extra else "\nwithout extras:")
        for name in sorted(sizes, key=sizes.__getitem__, reverse=True)[:LISTED]:
            print(f"{name:<20}{sizes[name]:8.0f} MB")
        print(f"{f'all {len(sizes)}':<20}{sum(sizes.values()):8.0f} MB")
    if sum(sizes.values()) >= MOST:
        sys.exit(f"a plain install takes more than {MOST} MB")
    if UNWANTED in sizes:
        sys.exit(f"a plain install brings {UNWANTED}; only the extra `reference` may")


if __name__ == "__main__":
    main()
