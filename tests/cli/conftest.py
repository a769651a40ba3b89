"""A small heart in files, good or spoilt, and the command line in this process."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import pyvista as pv
from builders import KUHN

from fascicle.core.leads import ELECTRODES

WIDTH, CELLS = 60.0, 8  # mm; cubes along each side of the tissue
RINGS, SPOKES = 9, 24

SMALL_PARAMETERS = {
    "lv_initial_length": 8.0, "rv_initial_length": 9.0,
    "lv_fascicle_length_1": 5.0, "lv_fascicle_length_2": 6.0,
    "rv_fascicle_length_1": 6.0, "rv_fascicle_length_2": 5.0,
    "lv_fascicle_angle_1": 0.9, "lv_fascicle_angle_2": -0.6,
    "rv_fascicle_angle_1": 0.7, "rv_fascicle_angle_2": -0.4,
    "root_time": -12.5, "cv": 2.7,
}  # fmt: skip


def cup_radius(depth):
    """Radius (mm) at a depth from 0, the apex, to 1, the rim."""
    return 11.0 * np.sqrt(np.maximum(depth, 0))


def block_of_tissue(cells=CELLS, hollow=False):
    """Points (n, 3) and tetrahedra (m, 4) of a block, with two cavities or without."""
    axis = np.arange(cells + 1)
    lattice = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    stride = np.array([(cells + 1) ** 2, cells + 1, 1])
    cubes = lattice[(lattice < cells).all(axis=1)]
    if hollow:
        x, y, z = (cubes.T + 0.5) * (WIDTH / cells)
        radius = cup_radius((z - 10.0) / 45.0)
        cubes = cubes[(np.hypot(np.minimum(abs(x - 15), abs(x - 45)), y - WIDTH / 2) > radius)]
    corner = cubes @ stride
    offsets = np.array([[k & 1, k >> 1 & 1, k >> 2] for k in range(8)]) @ stride
    tetrahedra = (corner[:, None, None] + offsets[KUHN][None]).reshape(-1, 4)
    return lattice * (WIDTH / cells), tetrahedra


def cup(centre_x):
    """Points and triangles of an open cup, its rim at z = 55 mm, its apex at z = 10 mm."""
    points, triangles = [[centre_x, WIDTH / 2, 10.0]], []
    for ring in range(1, RINGS + 1):
        depth = ring / RINGS
        angle = 2 * np.pi * np.arange(SPOKES) / SPOKES
        radius = cup_radius(depth)
        x, y = centre_x + radius * np.cos(angle), WIDTH / 2 + radius * np.sin(angle)
        points += np.column_stack([x, y, np.full(SPOKES, 10.0 + 45.0 * depth)]).tolist()
    for k in range(SPOKES):
        following = (k + 1) % SPOKES
        triangles.append([0, 1 + k, 1 + following])
        for ring in range(RINGS - 1):
            a, b = 1 + ring * SPOKES + k, 1 + ring * SPOKES + following
            triangles += [[a, a + SPOKES, b], [b, a + SPOKES, b + SPOKES]]
    return np.array(points), np.array(triangles)


def grid(points, tetrahedra, point_data=None, cell_data=None):
    mesh = pv.UnstructuredGrid({pv.CellType.TETRA: np.asarray(tetrahedra)}, np.asarray(points))
    mesh.point_data.update(point_data or {})
    mesh.cell_data.update(cell_data or {})
    return mesh


def surface(points, triangles):
    return pv.PolyData.from_regular_faces(np.asarray(points, float), np.asarray(triangles))


def write_electrodes(path):
    """Nine places around the block."""
    angle = 2 * np.pi * np.arange(len(ELECTRODES)) / len(ELECTRODES)
    ring = np.column_stack([150 * np.cos(angle), 110 * np.sin(angle), 40 * np.sin(3 * angle)])
    frame = pd.DataFrame(ring + WIDTH / 2, ELECTRODES, ["x", "y", "z"])
    frame.to_csv(path, index_label="name")
    return path


@dataclass
class Materials:
    """The five files of `fascicle heart import`, any of which a test replaces."""

    folder: Path
    grid, surface = staticmethod(grid), staticmethod(surface)

    def __post_init__(self):
        self.points, self.tetrahedra = block_of_tissue()
        angle = np.arcsin(0.6) + 1e-4 * self.points[:, 2]  # fibres all alike are a placeholder
        self.fibres = np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)])
        self.lv_surface, self.rv_surface = cup(15.0), cup(45.0)
        self.files = {
            "mesh": self.save("mesh.vtu", grid(self.points, self.tetrahedra)),
            "fibres": self.save(
                "fibres.vtu", grid(self.points, self.tetrahedra, {"fibre": self.fibres})
            ),
            "lv-endocardium": self.save("lv.vtp", surface(*self.lv_surface)),
            "rv-endocardium": self.save("rv.vtp", surface(*self.rv_surface)),
            "electrodes": write_electrodes(self.folder / "electrodes.csv"),
        }

    def save(self, name, data, **options):
        path = self.folder / name
        data.save(path, **options)
        return path

    def command(self, out, *extra, **replaced):
        files = self.files | {key.replace("_", "-"): value for key, value in replaced.items()}
        options = [text for key, value in files.items() for text in (f"--{key}", str(value))]
        return ["heart", "import", *options, "--out", str(out), *map(str, extra)]


@dataclass
class Ended:
    """How a command ended."""

    status: int
    out: str
    err: str

    @property
    def well(self):
        """Whether it ended well; hearts that are no human ones get warnings, one line each."""
        said = self.err.splitlines()
        return self.status == 0 and all(line.startswith(("warning: ", "took ")) for line in said)


def exit_status(*arguments):
    """Exit status of `fascicle ...`, run in this process."""
    from fascicle.cli import main

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["fascicle", *map(str, arguments)])
        try:
            main()
        except SystemExit as leaving:
            return leaving.code if isinstance(leaving.code, int) else 0
    return 0


@pytest.fixture
def run(monkeypatch, capfd):
    """Run `fascicle ...` in this process; what VTK prints by itself is captured too."""
    # a slow machine takes seconds to prepare a heart, and then says so
    monkeypatch.setattr("fascicle.core.progress.ProgressLines._speak", lambda self: None)

    def call(*arguments):
        capfd.readouterr()
        return Ended(exit_status(*arguments), *capfd.readouterr())

    return call


@pytest.fixture
def refused(run):
    """Run a command that must end in one line on stderr, with these words in it."""

    def call(arguments, *words):
        ended = run(*arguments)
        assert ended.status == 2, ended
        assert ended.out == ""
        assert ended.err.startswith("error: ")
        assert ended.err.count("\n") == 1, ended.err
        assert ended.err.endswith("\n")
        for word in words:
            assert str(word) in ended.err, ended.err
        return ended.err

    return call


@pytest.fixture
def blank_pictures(monkeypatch):
    """Draw nothing into pictures, which takes seconds each; tests/reporting looks at them."""
    from matplotlib.figure import Figure

    for name in (
        "recording.recording_figure", "heart.check_figure", "heart.labels_figure",
        "prediction.ecg_figure", "prediction.activation_figure", "prediction.spread_figure",
        "prediction.index_figure", "prediction.sweep_figure",
    ):  # fmt: skip
        monkeypatch.setattr(f"fascicle.reporting.{name}", lambda *_, **__: Figure(figsize=(1, 1)))


@pytest.fixture
def materials(tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    return Materials(folder)


@pytest.fixture
def outside(tmp_path):
    """A folder for outputs that must stay as it is when a command is refused."""
    folder = tmp_path / "outside"
    folder.mkdir()
    return folder


@pytest.fixture
def import_refused(materials, outside, refused):
    """Refuse an import with some files replaced; nothing may be left beside --out."""

    def call(*words, extra=(), **replaced):
        message = refused(materials.command(outside / "heart", *extra, **replaced), *words)
        assert list(outside.iterdir()) == []
        return message

    return call


@pytest.fixture(scope="session")
def small_heart(tmp_path_factory):
    """Folder of the small heart."""
    from fascicle.heart.assembly import assemble_heart
    from fascicle.heart.folder import write_heart
    from fascicle.mesh.read import read_mesh

    materials = Materials(tmp_path_factory.mktemp("materials"))
    files = materials.files
    hollow = grid(*block_of_tissue(12, hollow=True))
    hollow.cell_data["fibre"] = np.tile([0.6, 0.0, 0.8], (hollow.n_cells, 1))
    files["mesh"] = files["fibres"] = materials.save("hollow.vtu", hollow)
    heart = assemble_heart(
        mesh=read_mesh(files["mesh"]),
        fibres=read_mesh(files["fibres"]),
        surfaces={side: read_mesh(files[f"{side}-endocardium"]) for side in ("lv", "rv")},
        seeds={"lv": (None, None), "rv": (None, None)},
        electrodes=files["electrodes"],
        name="block",
    )
    folder = tmp_path_factory.mktemp("hearts") / "block"
    write_heart(heart, folder)
    return folder


@pytest.fixture(scope="session")
def written(small_heart, tmp_path_factory):
    """Outputs of a simulation of the small heart from parameters."""
    folder = tmp_path_factory.mktemp("simulated")
    values = "".join(f"{name} = {value}\n" for name, value in SMALL_PARAMETERS.items())
    (folder / "parameters.toml").write_text(values)
    options = "--params", folder / "parameters.toml", "--out", folder / "out"
    assert exit_status("simulate", small_heart, *options) == 0
    return folder / "out"


@pytest.fixture
def parameters(tmp_path):
    """Write a parameter file; every value given replaces one of the small heart's."""

    def write(name="parameters.toml", **replaced):
        values = SMALL_PARAMETERS | replaced
        lines = [f"{key} = {value}" for key, value in values.items() if value is not None]
        path = tmp_path / name
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return path

    return write


@pytest.fixture(scope="module", autouse=True)
def two_tissues():
    """Average over two tissues in place of five, each of which takes its time to prepare."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fascicle.networks.prior.TISSUES", ({}, {"anisotropy_ratio": 2.0}))
        yield


@pytest.fixture(scope="module", autouse=True)
def unplaced_pictures():
    """Leave the parts of figures where they are, which takes longer than to draw them."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ConstrainedLayoutEngine, "execute", lambda self, figure: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def compiled():
    """Compile the kernels before a program says on its standard error that it does."""
    from fascicle.forward.preparation import compile_kernels

    compile_kernels(lambda *_: None)
