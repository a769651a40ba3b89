"""Where the real data are, and the hearts that many tests share."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from emulated import Emulated

    from fascicle.forward.model import ForwardModel
    from fascicle.heart.heart import Heart

REPOSITORY = Path(__file__).resolve().parents[1]
DEFAULT_DATA = REPOSITORY.parent / "shared" / "data"

# The same examples in every run, so that whoever changes nothing sees nothing fail;
# `pytest --hypothesis-profile default` draws new ones
settings.register_profile("same", derandomize=True)
settings.load_profile("same")


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep what is cached for a user apart from this one's, and begin with nothing.

    The workers of pytest-xdist share it, so that a heart is prepared once.
    """
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FASCICLE_CACHE", str(folder / "cache"))
        yield


@pytest.fixture(scope="session", autouse=True)
def coarse_pictures() -> Iterator[None]:
    """Draw figures at a third of their resolution, as a test reads what is in them."""
    from matplotlib.figure import Figure

    drawn = Figure.savefig

    def savefig(figure: Figure, *arguments: Any, dpi: float = 150, **options: Any) -> None:
        drawn(figure, *arguments, dpi=dpi / 3, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", savefig)
        yield


@pytest.fixture(scope="session", autouse=True)
def small_posteriors() -> Iterator[None]:
    """Few particles, and bodies that take no minutes."""

    def bodies(model: ForwardModel, rng: Any, count: int, *_: Any) -> list[Any]:
        plain = model.electrocardiograph
        size = len(plain.corners)
        return [plain.scaled(np.full(size, gain)) for gain in rng.uniform(0.7, 1.4, count)]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fascicle.study.methods.PosteriorFit.least_particles", 200)
        patch.setattr("fascicle.study.methods.PosteriorFit.most_batches", 1)
        patch.setattr("fascicle.networks.prior_simulations.random_bodies", bodies)
        yield


def once(function: Callable[..., Any], arrays: Callable[..., Any]) -> Callable[..., Any]:
    """The function, which is called once with each content of the `arrays` of its arguments."""
    found = dict[str, Any]()

    def call(*given: Any) -> Any:
        from fascicle.heart.heart import digest_of

        key = digest_of(*map(np.asarray, arrays(*given)))
        if key not in found:
            found[key] = function(*given)
        return found[key]

    return call


@pytest.fixture(scope="session", autouse=True)
def hearts_prepared_once(own_cache: None) -> Iterator[None]:
    """Do what takes seconds once for all copies of a heart, if nothing has changed that it needs.

    Read a packaged heart, see what lies in its cavities and walls, and trace rays in a tissue.
    """
    from fascicle.core.files import ArrayCache, user_cache
    from fascicle.forward.eikonal import build
    from fascicle.forward.preparation import with_numbers
    from fascicle.heart import folder, sites
    from fascicle.heart.heart import digest_of
    from fascicle.kernels.arrays import TravelTimeTable
    from fascicle.mesh import checks

    packaged = Path(folder.__file__).parents[1] / "data"
    read, trace = folder.load_heart, build.build_travel_time_table
    read_packaged = cache(read)
    tables = ArrayCache(user_cache(), "table")

    def load_heart(path: Path | str, **person: Any) -> Heart:
        known = isinstance(path, Path) and path.is_relative_to(packaged)
        return read_packaged(path) if known else read(path, **person)

    def traced(mesh: Any, surface: Any, owner: Any, triangles: Any, *options: Any) -> Any:
        if len(mesh.corners) < 20_000 or len(options) > 2:
            return trace(mesh, surface, owner, triangles, *options)
        rays = mesh.vertices, mesh.corners, mesh.cells, mesh.neighbours, np.array(mesh.slowness)
        key = digest_of(*rays, surface, owner, triangles, np.array(options[1:], dtype=np.int64))
        if (arrays := tables.read(key)) is None:
            table = trace(mesh, surface, owner, triangles, *options)
            tables.write(key, table._asdict())
            return table
        return TravelTimeTable(**with_numbers(arrays))

    def parts(space: Any, mesh: Any) -> Any:
        return mesh.vertices, mesh.tetrahedra, mesh.triangles, mesh.labels

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(folder, "load_heart", load_heart)
        wound = once(checks.winding_number, lambda *arrays: arrays)
        patch.setattr(checks, "winding_number", wound)
        patch.setattr(sites, "wall_potentials", once(sites.wall_potentials, parts))
        patch.setattr(build, "build_travel_time_table", traced)
        yield


@pytest.fixture(scope="module")
def plain_tissue() -> Iterator[None]:
    """Networks of posteriors in the plain tissue alone: each other one takes ten seconds."""

    def first(averaged: Any, points: Any) -> Any:
        return np.zeros(len(points), np.intp)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fascicle.networks.prior.AveragedOver.tissue", first)
        yield


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Folder of real recordings and hearts; tests that need it skip where it is missing."""
    folder = Path(os.environ.get("FASCICLE_TEST_DATA", DEFAULT_DATA))
    if not (folder / "ecg").is_dir():
        pytest.skip(f"no test data in {folder}; set FASCICLE_TEST_DATA")
    return folder


@pytest.fixture(scope="session")
def default_heart() -> Heart:
    """The packaged heart."""
    from fascicle.heart.folder import load_heart

    return load_heart("default")


@pytest.fixture(scope="session")
def default_model(default_heart: Heart) -> ForwardModel:
    """Forward model of the packaged heart."""
    from fascicle.forward.model import ForwardModel

    return ForwardModel(default_heart)


@pytest.fixture(scope="session")
def small_heart() -> Heart:
    """Ventricles of 1,000 vertices, on which `anatomies.NETWORK` fits."""
    from anatomies import heart_on

    return heart_on()


@pytest.fixture(scope="session")
def ventricles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a built heart with sheets, a region of scar, and endocardia in register."""
    from anatomies import write_built_heart

    return write_built_heart(tmp_path_factory.mktemp("ventricles"))


@pytest.fixture(scope="session")
def small_model(small_heart: Heart) -> ForwardModel:
    """Forward model of the small heart, prepared in a tenth of a second."""
    from fascicle.forward.model import ForwardModel

    return ForwardModel(small_heart)


@pytest.fixture(scope="session")
def atlas_model(small_heart: Heart) -> ForwardModel:
    """Forward model of an atlas of two hearts, whose template is the small heart."""
    from anatomies import atlas_on

    from fascicle.forward.model import ForwardModel

    return ForwardModel(atlas_on(small_heart))


@pytest.fixture(scope="session")
def torso_model(default_heart: Heart) -> ForwardModel:
    """Of the packaged heart with one more electrode where LA is, and few torsos solved."""
    from fascicle.forward.model import ForwardModel
    from fascicle.heart.conduction import Conduction
    from fascicle.torso.lead_fields import key_of
    from fascicle.torso.training import build_response

    quick = partial(build_response, mode_torsos=4, modes=20, outer_torsos=14)
    fields = default_heart.lead_fields
    assert fields is not None
    heart = replace(
        default_heart,
        # kept nowhere: other tests would take the crude response for the heart's
        folder=None,
        additional_electrodes={"E1": default_heart.electrodes[1]},
        lead_fields=replace(fields, values=fields.values[[*range(9), 1]]),
    )
    fields = replace(heart.lead_fields, key=key_of(heart, Conduction()))
    model = ForwardModel(replace(heart, lead_fields=fields))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fascicle.forward.torso_model.build_response", quick)
        model.torso(["heart_up"])
    return model


@pytest.fixture(scope="session")
def crtdemo(data_folder: Path) -> Heart:
    """A patient's heart, imported as `fascicle heart import` does, with the published seeds."""
    from fascicle.heart.assembly import assemble_heart
    from fascicle.mesh.read import read_mesh

    folder = data_folder / "hearts" / "crtdemo"
    return assemble_heart(
        mesh=read_mesh(folder / "crtdemo_mesh_oriented.vtk", "mesh"),
        fibres=read_mesh(folder / "crtdemo_f0_oriented.vtk", "fibres"),
        surfaces={
            side: read_mesh(folder / f"crtdemo_{side.upper()}endo_heart_cut.obj")
            for side in ("lv", "rv")
        },
        seeds={"lv": (388, 412), "rv": (198, 186)},
        electrodes=folder / "electrodes_mm.csv",
        name="crtdemo",
    )


@pytest.fixture(scope="session")
def crtdemo_model(crtdemo: Heart) -> ForwardModel:
    """Forward model of the patient's heart."""
    from fascicle.forward.model import ForwardModel

    return ForwardModel(crtdemo)


@pytest.fixture(scope="session")
def emulated() -> Emulated:
    """A processor that stands in for a graphics card."""
    from emulated import RANDOM, Emulated

    return Emulated(order=RANDOM)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium, with WebGL and without a graphics card."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("no chromium on the path")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    webgl = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with playwright.sync_playwright() as running:
        opened = running.chromium.launch(executable_path=chromium, args=[*webgl, "--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture
def visit(browser: Any) -> Iterator[Any]:
    """Open pages; in the end none complained, or asked for anything elsewhere."""
    said, asked, contexts = list[str](), list[str](), []

    def open_page(url: str, **options: Any) -> Any:
        contexts.append(browser.new_context(**options))
        page = contexts[-1].new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(url)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert said == []
    here = re.compile(r"(http|ws)://127\.0\.0\.1|about:|blob:|data:|file:")
    assert [address for address in asked if not here.match(address)] == []
