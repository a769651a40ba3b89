"""The project's page on a package index: README.md, whose links lead to `Source`.

Everything else about the package stands in pyproject.toml. Without a public address there
(``urls.Source``, of a repository on GitHub), relative links become their text, and pictures are
left out with their captions.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from setuptools import setup

PICTURE = r"!\[(?P<text>[^\]]*)\]\((?P<path>(?!https?:)[^)]+)\)"
LINK = r"(?<!!)\[(?P<text>[^\]]+)\]\((?P<path>(?!https?:|#)[^)]+)\)"
CAPTION = r"\n\n\*(?!\*)[^\n](?:[^\n]|\n(?!\n))*\*(?=\n)"


def long_description(readme: str, source: str | None) -> str:
    """Text of the project's page, from README.md and the repository's address."""
    if source is None:
        without_pictures = re.sub(rf"{PICTURE}(?:{CAPTION})?\n*", "", readme)
        return re.sub(LINK, r"\g<text>", without_pictures)
    readme = re.sub(PICTURE, rf"![\g<text>]({source}/raw/HEAD/\g<path>)", readme)
    return re.sub(LINK, rf"[\g<text>]({source}/blob/HEAD/\g<path>)", readme)


if __name__ == "__main__":
    folder = Path(__file__).parent
    project = tomllib.loads((folder / "pyproject.toml").read_text("utf-8"))["project"]
    readme = (folder / "README.md").read_text("utf-8")
    setup(
        long_description=long_description(readme, project.get("urls", {}).get("Source")),
        long_description_content_type="text/markdown",
    )
