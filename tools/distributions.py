"""Build the source distribution and the wheel, and compare their files with the repository's.

The requirements of the conda recipe are compared with those of the project, too.

    python tools/distributions.py [FOLDER]

Builds both as an index would get them (the wheel from the source distribution) into FOLDER, `dist`
unless given, and ends with status 1 if a file that git knows is missing, or one that it does not
know is there. `python -m build` downloads the build backend.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Iterable
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
# of the repository alone: what CI runs, and forms of the site that hosts it
NOT_PACKED = re.compile(r"\.(ci|github)/")
# of the distributions alone
GENERATED = re.compile(r"PKG-INFO|setup\.cfg|(src/)?fascicle_ecg[^/]*\.(egg|dist)-info/")
# where a wheel has what the repository has in docs
DOCUMENTATION = re.compile(r"fascicle_ecg-[^/]*\.data/data/share/doc/fascicle/")


def packed(source: Path, wheel: Path) -> tuple[set[str], set[str]]:
    """Files of both distributions by their paths in the repository."""
    with tarfile.open(source) as archive:
        names = (member.name.partition("/")[2] for member in archive if member.isfile())
        in_source = {name for name in names if not GENERATED.match(name)}
    with zipfile.ZipFile(wheel) as content:
        names = (DOCUMENTATION.sub("docs/", name) for name in content.namelist())
        in_wheel = {re.sub("^fascicle/", "src/fascicle/", name) for name in names}
    return in_source, {name for name in in_wheel if not GENERATED.match(name)}


def requirements(lines: Iterable[str]) -> set[str]:
    """Requirements in one spelling, by their names on PyPI."""
    on_pypi = {"igl": "libigl", "matplotlib-base": "matplotlib"}
    parts = (re.split("(?=[<>])", re.sub("[ ,]", "", line), maxsplit=1) for line in lines)
    return {
        on_pypi.get(name, name) + "".join(sorted(re.findall("[<>]=?[^<>]+", versions)))
        for name, versions in parts
    }


def recipe_faults() -> list[str]:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]
    needed = project["dependencies"] + project["optional-dependencies"]["build"]
    recipe = (REPOSITORY / "conda" / "meta.yaml").read_text("utf-8")
    run = re.findall(r"^    - ((?!python|setuptools)\S+ [<>][^ #\n]+)", recipe, re.MULTILINE)
    differing = requirements(needed) ^ requirements(run)
    versions = {"conda/meta.yaml": 'version = "{}"', "CITATION.cff": "version: {}"}
    return [f"conda/meta.yaml: {requirement}" for requirement in sorted(differing)] + [
        f"{file}: another version than in pyproject.toml"
        for file, line in versions.items()
        if line.format(project["version"]) not in (REPOSITORY / file).read_text("utf-8")
    ]


def main(folder: Path) -> None:
    command = [sys.executable, "-m", "build", "--outdir", str(folder), str(REPOSITORY)]
    built = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if built.returncode:
        sys.exit(built.stdout)
    (source,), (wheel,) = folder.glob("fascicle_ecg-*.tar.gz"), folder.glob("fascicle_ecg-*.whl")
    listed = subprocess.check_output(["git", "-C", REPOSITORY, "ls-files"], text=True).split("\n")
    tracked = {name for name in listed if name and not NOT_PACKED.match(name)}
    installed = {name for name in tracked if re.match(r"src/|docs/[^/]*\.md$", name)}
    in_source, in_wheel = packed(source, wheel)
    faults = [
        f"{archive.name}: {name} {fault}"
        for archive, files, expected in ((source, in_source, tracked), (wheel, in_wheel, installed))
        for fault, names in (("is missing", expected - files), ("is not in git", files - expected))
        for name in sorted(names)
    ]
    faults += recipe_faults()
    print(*faults, f"{source.name}: {len(in_source)} files", sep="\n")
    print(f"{wheel.name}: {len(in_wheel)} files, {wheel.stat().st_size / 1e6:.0f} MB")
    if faults:
        sys.exit(1)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "dist"))
