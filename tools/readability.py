"""Measure how readable the README and the pages of the documentation are.

    python tools/readability.py [PAGE ...]

Prints for each page its sentences, their mean and longest length in words, and the longest
caption of a figure, and ends with status 1 where a limit is exceeded. With `--list` it prints every
sentence and caption that is too long.

Sentences are those of paragraphs and lists. Headings, tables, code and footnotes, which hold
references, are not counted. Code in a sentence is a word. A caption is the emphasised paragraph
after an image.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from markdown_it import MarkdownIt
from markdown_it.token import Token

LONGEST_SENTENCE = 25
MEAN_SENTENCE = 17.0
LONGEST_CAPTION = 20
ABBREVIATIONS = ("e.g.", "i.e.", "et al.", "vs.", "approx.", "Fig.", "Eq.", "no.", "Dr.", "St.")
END_OF_SENTENCE = re.compile(r"(?<=[.!?])(?:[\"”)*]*)\s+(?=[A-Z0-9\"“(*`†αβσθ])")
FOOTNOTE = re.compile(r"^\[\^[^\]]+\]:.*(?:\n(?: {2,}|\t).*)*", re.MULTILINE)


class Page(NamedTuple):
    """Sentences and captions of a page."""

    sentences: list[str]
    captions: list[str]

    @classmethod
    def read(cls, path: Path) -> Page:
        """Sentences and captions of a Markdown file."""
        tokens = (
            MarkdownIt("commonmark")
            .enable("table")
            .parse(FOOTNOTE.sub("", path.read_text(encoding="utf-8")))
        )
        page = cls([], [])
        after_image = False
        for before, token in pairwise(tokens):
            if token.type != "inline" or before.tag != "p":  # headings and tables
                continue
            children = token.children or []
            if after_image and emphasised(children):
                page.captions.append(plain(children))
            else:
                page.sentences.extend(sentences(plain(children)))
            after_image = [child.type for child in children] == ["image"]
        return page


def plain(children: list[Token]) -> str:
    """Text as it is read: code is a word, an image is none."""
    parts = []
    for child in children:
        if child.type == "code_inline":
            parts.append("`code`")
        elif child.type in ("softbreak", "hardbreak"):
            parts.append(" ")
        elif child.type == "text":
            parts.append(re.sub(r"\[\^[^\]]+\]", "", child.content))
    return "".join(parts)


def emphasised(children: list[Token]) -> bool:
    """Whether a paragraph is in italics from its beginning to its end."""
    shown = [child for child in children if child.type != "text" or child.content.strip()]
    return bool(shown) and shown[0].type == "em_open" and shown[-1].type == "em_close"


def sentences(text: str) -> Iterator[str]:
    """Sentences of a paragraph; neither an abbreviation nor an initial ends one."""
    begun = ""
    for part in END_OF_SENTENCE.split(text):
        begun = f"{begun} {part}".strip()
        if begun.endswith(ABBREVIATIONS) or re.search(r"\b[A-Z]\.$", begun):
            continue
        yield begun
        begun = ""
    if begun:
        yield begun


def words(text: str) -> int:
    return sum(any(letter.isalnum() for letter in word) for word in text.split())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", type=Path)
    parser.add_argument("--list", action="store_true", help="print what is too long")
    options = parser.parse_args()
    top = Path(__file__).resolve().parents[1]
    paths = options.pages or [top / "README.md", *sorted((top / "docs").glob("*.md"))]
    status = 0
    print(f"{'page':24}{'sentences':>10}{'mean':>7}{'longest':>9}{'caption':>9}")
    for path in paths:
        page = Page.read(path)
        lengths = [words(sentence) for sentence in page.sentences] or [0]
        mean = sum(lengths) / len(lengths)
        caption = max(map(words, page.captions), default=0)
        print(f"{path.stem:24}{len(lengths):10}{mean:7.1f}{max(lengths):9}{caption:9}")
        long = [s for s in page.sentences if words(s) > LONGEST_SENTENCE]
        long += [c for c in page.captions if words(c) > LONGEST_CAPTION]
        status |= bool(long) or mean > MEAN_SENTENCE
        if options.list:
            print(*(f"    {words(text):3} {text}" for text in long), sep="\n")
    print(
        f"At most: mean {MEAN_SENTENCE:g}, sentence {LONGEST_SENTENCE}, "
        f"caption {LONGEST_CAPTION} words"
    )
    return status


if __name__ == "__main__":
    sys.exit(main())
