"""Run the fuzzing; see the package."""

from __future__ import annotations

import argparse
import collections
import sys
import tempfile
import time
from pathlib import Path

from benchmarks import fuzzing
from benchmarks.fuzzing.attempts import outcomes
from benchmarks.fuzzing.calls import CALLS
from benchmarks.fuzzing.kinds import KINDS


def main() -> int:
    parser = argparse.ArgumentParser(description=fuzzing.__doc__)
    parser.add_argument("kinds", nargs="*", default=[*KINDS, *CALLS], metavar="KIND")
    parser.add_argument("--number", type=int, default=20_000)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    failed = 0
    for name in options.kinds:
        start, read, refused, slowest = time.monotonic(), 0, 0, 0.0
        failures: dict[str, list[int]] = collections.defaultdict(list)
        with tempfile.TemporaryDirectory() as folder:
            numbers = range(options.first, options.first + options.number)
            for outcome in outcomes(name, numbers, Path(folder)):
                slowest = max(slowest, outcome.seconds)
                if outcome.failure:
                    failures[outcome.failure].append(outcome.number)
                elif outcome.answered:
                    read += 1
                else:
                    refused += 1
        failed += len(failures)
        print(
            f"{name}: {read} read, {refused} refused, {sum(map(len, failures.values()))} failed; "
            f"slowest {slowest:.1f} s, {time.monotonic() - start:.0f} s in all",
            flush=True,
        )
        for failure, numbers_of in sorted(failures.items(), key=lambda item: -len(item[1])):
            print(f"  {len(numbers_of)} (first {numbers_of[:3]}): {failure}", flush=True)
    return min(failed, 1)


if __name__ == "__main__":
    sys.exit(main())
