"""Damage to files: each function takes bytes and a generator, and gives other bytes."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

NUMBER = re.compile(rb"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")
WORD = re.compile(rb"[A-Za-z_][\w.-]+")
TEXTS = (
    b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e-308", b"1e400", b"0", b"-1", b"1", b"-0.0",
    b"0.1", b"255", b"65536", b"2147483647", b"-2147483648", b"4294967296", b"9223372036854775807",
    b"18446744073709551616", b"1e20", b"9" * 400, b"", b"true", b'"x"', b"[]", b"{}",
)  # fmt: skip
INTEGERS = (0, 1, -1, 127, 128, 255, 2**15 - 1, 2**15, 2**16, 2**24, 2**31 - 1, 2**31, 2**32 - 1,
            2**40, 2**62, 2**63 - 1)  # fmt: skip
FLOATS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-308, 0.0, -1.0, 1e20)


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """Content with one damage of any kind, or a few."""
    for _ in range(rng.geometric(0.7)):
        content = MUTATIONS[rng.integers(len(MUTATIONS))](content, rng)
    return content


def _place(content: bytes, rng: np.random.Generator) -> int:
    """A place in the content, often near its start, where headers are."""
    within = len(content) if rng.random() < 0.5 else min(len(content), 1000)
    return int(rng.integers(within + 1))


def _block(content: bytes, rng: np.random.Generator) -> tuple[int, int]:
    start = _place(content, rng)
    return start, start + int(2 ** rng.uniform(0, np.log2(len(content) + 2)))


def flipped_bits(content: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(content)
    for _ in range(rng.integers(1, 9) if changed else 0):
        changed[min(_place(content, rng), len(changed) - 1)] ^= 1 << rng.integers(8)
    return bytes(changed)


def cut(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: int(rng.integers(len(content) + 1))]


def lost_block(content: bytes, rng: np.random.Generator) -> bytes:
    start, end = _block(content, rng)
    return content[:start] + content[end:]


def doubled_block(content: bytes, rng: np.random.Generator) -> bytes:
    start, end = _block(content, rng)
    return content[:end] + content[start:]


def swapped_blocks(content: bytes, rng: np.random.Generator) -> bytes:
    a, b, c, d = sorted(_place(content, rng) for _ in range(4))
    return content[:a] + content[c:d] + content[b:c] + content[a:b] + content[d:]


def _one_match(
    pattern: re.Pattern[bytes], content: bytes, rng: np.random.Generator
) -> re.Match[bytes] | None:
    """A match near a random place."""
    start = _place(content, rng)
    return pattern.search(content, start) or pattern.search(content)


def extreme_text(content: bytes, rng: np.random.Generator) -> bytes:
    """A number in a text becomes an extreme one, or none."""
    match = _one_match(NUMBER, content, rng)
    if match is None:
        return content
    return content[: match.start()] + TEXTS[rng.integers(len(TEXTS))] + content[match.end() :]


def extreme_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """Bytes that may be a number become an extreme one."""
    order = "<>"[rng.integers(2)]
    if rng.random() < 0.5:
        size = int(rng.choice([1, 2, 4, 8]))
        value = INTEGERS[rng.integers(len(INTEGERS))] % 2 ** (8 * size)
        packed = value.to_bytes(size, "little" if order == "<" else "big")
    else:
        code = ("f4", "f8")[rng.integers(2)]
        with np.errstate(over="ignore"):
            packed = np.array(FLOATS[rng.integers(len(FLOATS))]).astype(order + code).tobytes()
    at = _place(content, rng)
    if rng.random() < 0.5:
        at -= at % len(packed)
    return content[:at] + packed + content[at + len(packed) :]


def _lines(content: bytes, rng: np.random.Generator) -> tuple[list[bytes], int]:
    lines = content.split(b"\n")
    within = len(lines) if rng.random() < 0.5 else min(len(lines), 20)
    return lines, int(rng.integers(within))


def dropped_line(content: bytes, rng: np.random.Generator) -> bytes:
    lines, k = _lines(content, rng)
    del lines[k]
    return b"\n".join(lines)


def repeated_line(content: bytes, rng: np.random.Generator) -> bytes:
    lines, k = _lines(content, rng)
    times = 1 if rng.random() < 0.7 else 300
    return b"\n".join(lines[:k] + [lines[k]] * times + lines[k:])


def swapped_lines(content: bytes, rng: np.random.Generator) -> bytes:
    lines, k = _lines(content, rng)
    other = int(rng.integers(len(lines)))
    lines[k], lines[other] = lines[other], lines[k]
    return b"\n".join(lines)


def swapped_words(content: bytes, rng: np.random.Generator) -> bytes:
    """Two words of a text, such as keys, change places."""
    first, second = (_one_match(WORD, content, rng) for _ in range(2))
    if first is None or second is None or first.start() == second.start():
        return content
    first, second = sorted((first, second), key=lambda match: match.start())
    return (
        content[: first.start()] + second[0] + content[first.end() : second.start()] + first[0]
        + content[second.end() :]
    )  # fmt: skip


MUTATIONS: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    flipped_bits, cut, lost_block, doubled_block, swapped_blocks, extreme_text, extreme_text,
    extreme_text, extreme_bytes, extreme_bytes, dropped_line, repeated_line, swapped_lines,
    swapped_words,
)  # fmt: skip
