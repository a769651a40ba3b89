"""The documentation's site builds without a warning, and names everything that is public."""

import json
import re
import runpy
from pathlib import Path

import pytest

import fascicle
from fascicle.forward.likelihood import QrsLikelihood
from fascicle.networks.prior import NOT_KNOWN
from fascicle.networks.prior_simulations import PriorSimulations
from fascicle.networks.settings import FitSettings
from fascicle.study.methods import PosteriorFit

REPOSITORY = Path(__file__).resolve().parents[1]
DOCS = REPOSITORY / "docs"
# As they are before `small_posteriors` changes them
PARTICLES, BATCHES = PosteriorFit.least_particles, PosteriorFit.most_batches


def test_every_public_name_is_in_the_api():
    page = (DOCS / "api.md").read_text(encoding="utf-8")
    named = set(re.findall(r"auto\w+:: fascicle\.(\w+)", page)) | set(
        re.findall(r"^`([A-Z_]+)`$", page, re.MULTILINE)
    )
    assert named == set(fascicle.__all__)


def test_readme_on_a_package_index():
    long_description = runpy.run_path(str(REPOSITORY / "setup.py"))["long_description"]
    text = "A.\n\n![B](c.png)\n\n*D [e](f.md).*\n\n[G](h.md), [i](https://j.k)\n"
    assert long_description(text, None) == "A.\n\nG, [i](https://j.k)\n"
    assert long_description(text, "https://l.m") == (
        "A.\n\n![B](https://l.m/raw/HEAD/c.png)\n\n*D [e](https://l.m/blob/HEAD/f.md).*\n\n"
        "[G](https://l.m/blob/HEAD/h.md), [i](https://j.k)\n"
    )
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    page = long_description(readme, None)
    assert not re.search(r"!\[|\]\((?!https?:|#)", page)
    assert re.findall("^#.*", page, re.MULTILINE) == re.findall("^#.*", readme, re.MULTILINE)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    from sphinx.cmd.build import main

    out = tmp_path_factory.mktemp("site")
    arguments = ["-W", "--keep-going", "-q", "-b", "html", str(DOCS), str(out)]
    assert main(arguments) == 0
    return out


def test_what_the_site_holds_and_loads(site):
    pages = {path.stem for path in DOCS.glob("*.md")}
    assert pages <= {path.stem for path in site.glob("*.html")}
    api = (site / "api.html").read_text(encoding="utf-8")
    assert all(f'id="fascicle.{name}"' in api for name in ("fit", "predict", "plot.ecg"))
    benchmarks = (site / "benchmarks.html").read_text(encoding="utf-8")
    for path in (REPOSITORY / "benchmarks").glob("*.py"):
        if f"python -m benchmarks.{path.stem}" in path.read_text(encoding="utf-8"):
            assert f"python -m benchmarks.{path.stem}" in benchmarks
    for path in site.glob("*.html"):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r'<(?:script|link|img)[^>]+(?:src|href)="https?:', text), path.name


@pytest.mark.parametrize("name", ["simulate_and_pace", "learn_and_predict"])
def test_notebooks_without_output(site, name):
    cells = json.loads((site / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    assert {cell["cell_type"] for cell in cells} == {"code", "markdown"}
    assert not any(cell.get("outputs") for cell in cells)


def test_the_posterior_s_page_states_the_numbers_of_the_code():
    page = (DOCS / "posterior.md").read_text(encoding="utf-8")
    least, most = 100 * QrsLikelihood.shares[[0, -1]]
    assert f"{FitSettings().prior_simulations:,} networks" in page
    assert f"{PARTICLES} particles" in page
    assert f"up to {BATCHES} batches" in page
    assert f"log-uniform, {least:.0f} to {most:.0f} % of the recorded QRS" in page
    assert f"{PriorSimulations.torsos} torsos" in page
    table = (DOCS / "quantities.md").read_text(encoding="utf-8").partition("## What is averaged")[2]
    for parameter in NOT_KNOWN:
        how = f"{parameter.lower:g} to {parameter.upper:g}"
        if parameter.median is not None:
            how = f"{parameter.prior}, {parameter.median:g} ± {parameter.sd:g}"
        assert re.search(rf"`{parameter.name}` \| [^|]*{re.escape(how)}", table), parameter.name
