"""Which part of the heart's surface a name or a number means."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache

from fascicle.errors import InputError
from fascicle.geometry.surface import Label

Names = Mapping[str, Label]  # the caller's own names and numbers (as text) of labels

# Words that decide, in the order in which they do: "lv_epi" is epicardium, "rv base" is base.
DECIDING: dict[Label, tuple[str, ...]] = {
    Label.MITRAL: ("mitral", "mv"),
    Label.AORTIC: ("aortic", "aorta", "av", "aov"),
    Label.TRICUSPID: ("tricuspid", "tv"),
    Label.PULMONARY: ("pulmonary", "pulmonic", "pv"),
    Label.EPICARDIUM: ("epi", "epicardium", "epicardial"),
    Label.BASE: ("base", "basal"),
    Label.LV_ENDOCARDIUM: ("lv", "left"),
    Label.RV_ENDOCARDIUM: ("rv", "right"),
}
# Words that may stand beside them
OTHER_WORDS = (
    "endo", "endocardium", "endocardial", "ventricle", "ventricular", "ventricles", "heart",
    "surface", "surf", "sur", "face", "faces", "boundary", "wall", "valve", "annulus", "opening",
    "plane", "septum", "septal", "sept", "free", "cavity", "side", "set", "the", "of",
)  # fmt: skip
WORDS = {word for words in DECIDING.values() for word in words} | set(OTHER_WORDS)
LONGEST_NAME = 60  # characters


def label_of(name: str) -> Label | None:
    """Label that a name means, or None.

    Letter case, digits and separators do not matter, nor whether words are run together: "LV",
    "lv_endo", "LVendo", "endo-lv" and "Left ventricle" are all the left endocardium. Every word
    must be a known one, so that "lv_endo_stimulus" is nothing.
    """
    if len(name) > LONGEST_NAME:
        return None
    words: set[str] = set()
    for letters in re.findall("[^\\W\\d_]+", name.lower()):
        found = _words(letters)
        if found is None:
            return None
        words |= found
    meant = [label for label, deciding in DECIDING.items() if words.intersection(deciding)]
    both = {Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM}
    if not meant or set(meant) == both:
        return None
    return meant[0]


@cache
def _words(letters: str) -> frozenset[str] | None:
    """Known words that a run of letters is made of; None if it is not."""
    if not letters:
        return frozenset()
    for length in range(len(letters), 0, -1):
        if letters[:length] in WORDS:
            rest = _words(letters[length:])
            if rest is not None:
                return rest | {letters[:length]}
    return None


def label_of_number(source: str, number: int, names: Names, group: str | None = None) -> Label:
    """Label that a number means: the caller's, that of its group's name, or the `Label` itself.

    Parameters
    ----------
    source : str
        File and array, for an error.
    number : int
        What stands in the file.
    names : mapping of str to Label
        The caller's own names and numbers; they come first.
    group : str, optional
        Name of the physical group with this number.

    Raises
    ------
    InputError
        If it means no label.
    """
    for own in (group, str(number)):
        if own is not None and own in names:
            return names[own]
    if group is not None:
        label = label_of(group)
        if label is None:
            shown = "".join(c if c.isprintable() else "?" for c in group[:LONGEST_NAME])
            raise InputError(
                f"{source}: cannot tell which surface '{shown}' is; name it epi, base, lv_endo or "
                "rv_endo (or mitral, aortic, tricuspid, pulmonary)"
            )
        return label
    if number not in set(Label):
        known = ", ".join(f"{label.value} {label.name.lower()}" for label in Label)
        raise InputError(f"{source}: unknown label {number}; the labels are {known}")
    return Label(number)
