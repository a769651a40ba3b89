"""Response time of the explorer's page to its controls, and its stability in random play.

    python -m benchmarks.explorer [--heart camps-dti004] [--moves 100] [--minutes 0]

In headless Chromium with software rendering, on the machine that also simulates. Printed are, for
each slider in turn, median and ninth decile of the time (ms) from the moment that a state is asked
for until the frame that shows it; then, after so many minutes of random play (sliders, clicks,
scenarios, undo, pin, views), how many beats were shown, errors of the page, and the memory of page
and server at the beginning and at the end (MB).
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Page, sync_playwright

WEBGL = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
MOVE = """([name, share]) => {
  const { input } = explorer.inputs[name];
  input.value = Number(input.min) + share * (input.max - input.min);
  input.dispatchEvent(new Event("input"));
}"""
ACTIONS = [
    "undo",
    "pin this beat to compare with",
    "fire His: his pacing",
    "view: base",
    "start again",
]


def settled(page: Page) -> None:
    page.wait_for_function("window.explorer?.beat && !explorer.busy && !explorer.waiting")


def latencies(page: Page, name: str, moves: int) -> list[float]:
    """Times (ms) from asking for a state to the frame that shows it, while a slider moves."""
    settled(page)
    page.evaluate("explorer.latencies.length = 0")
    for k in range(moves):
        page.evaluate(MOVE, [name, 0.3 + 0.4 * k / moves])
        settled(page)
    page.wait_for_timeout(200)
    return list(page.evaluate("explorer.latencies"))


def play(page: Page, rng: np.random.Generator, names: list[str]) -> None:
    """Do something at random."""
    chance = rng.random()
    if chance < 0.6:
        page.evaluate(MOVE, [rng.choice(names), rng.random()])
    elif chance < 0.75:
        page.get_by_label("click", exact=True).select_option(index=int(rng.integers(3)))
        box = page.locator(".fx canvas").first.bounding_box()
        assert box is not None
        x, y = rng.random(2) * 0.6 + 0.2
        page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
    elif chance < 0.85:
        label = str(rng.choice(["beat", "conduction"]))
        page.get_by_label(label, exact=True).select_option(index=int(rng.integers(8)))
    else:
        page.get_by_role("button", name=str(rng.choice(ACTIONS))).click()
    page.wait_for_timeout(float(rng.uniform(0, 200)))


def memory(page: Page, server: int) -> tuple[float, float]:
    """Memory of page and server (MB)."""
    page.request_gc()
    held = page.evaluate("performance.memory.usedJSHeapSize") / 1e6
    status = Path(f"/proc/{server}/status").read_text()
    resident = re.search(r"VmRSS:\s+(\d+)", status)
    assert resident is not None
    return float(held), int(resident[1]) / 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--heart", default="camps-dti004")
    parser.add_argument("--moves", type=int, default=100)
    parser.add_argument("--minutes", type=float, default=0.0)
    arguments = parser.parse_args()
    command = [sys.executable, "-m", "fascicle.cli", "explore", arguments.heart, "--no-browser"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    url = server.stdout.readline().split()[-1]
    messages: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=WEBGL)
        page = browser.new_context(bypass_csp=True).new_page()
        page.on("console", lambda message: messages.append(message.text))
        page.on("pageerror", lambda error: messages.append(str(error)))
        page.goto(url)
        settled(page)
        # tissue is prepared on release, and the torso's lead fields take minutes: not measured
        names: list[str] = page.evaluate(
            "explorer.said.groups.slice(0, 2).flatMap((g) => g.sliders).map(({ name }) => name)"
        )
        for name in names:
            times = latencies(page, name, arguments.moves)
            print(f"{name:<22}{np.median(times):6.0f}{np.quantile(times, 0.9):6.0f}", flush=True)
        report_play(page, server.pid, names, arguments.minutes, messages)
        browser.close()
    server.wait()


def report_play(
    page: Page, server: int, names: list[str], minutes: float, messages: list[str]
) -> None:
    rng, until = np.random.default_rng(0), time.monotonic() + 60 * minutes
    began: Any = None
    while time.monotonic() < until:
        play(page, rng, names)
        if began is None and time.monotonic() > until - 54 * minutes:  # caches are full by then
            began = memory(page, server)
    if began is not None:
        settled(page)
        shown, ended = page.evaluate("explorer.number"), memory(page, server)
        print(f"{minutes:g} minutes: {shown} beats; {len(messages)} errors {messages[:3]}")
        for process, before, after in zip(("page", "server"), began, ended, strict=True):
            print(f"{process} {before:.0f} to {after:.0f} MB")


if __name__ == "__main__":
    main()
