"""Networks for openCARP, ParaView and tables: their files give the activation back."""

import re
from dataclasses import replace

import meshio
import numpy as np
import pandas as pd
import pytest
import pyvista as pv
from anatomies import NETWORK
from builders import block_of_random_tissue, case, conduction_for

from benchmarks.fuzzing import seeds
from benchmarks.references import solve_from_vertices
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.forward.activation_sequence import nearest_to_median
from fascicle.forward.eikonal.build import build_myocardium
from fascicle.forward.model import ForwardModel
from fascicle.forward.primitives import Stimulus
from fascicle.heart.conduction import Conduction, Region
from fascicle.mesh.mesh_file import TETRAHEDRON
from fascicle.mesh.opencarp import read_opencarp_mesh, read_vtx
from fascicle.networks.target_comparison import Network
from fascicle.purkinje.tree_files import read_tree
from fascicle.study.export import STIMULUS_STEP, tissue_table, tissue_tags, write_networks

LATE_LEFT = EXAMPLE_PARAMETERS | {"root_time": -50.0}  # whose left junctions the tissue reaches
# What openCARP's manual lists of its parameters, as far as they are used here
INTEGER, NUMBER, TEXT = r"-?\d+", r"-?\d+(\.\d+)?([eE][-+]?\d+)?", r'"[^"]+"|\w+'
GRAMMAR = {
    r"num_(phys_regions|imp_regions|gregions|stim|LATs)": INTEGER,
    r"(meshname|simID)": TEXT,
    r"tend|dt|dream\.fim\.tol": NUMBER,
    r"bidomain|dream\.(solve|fim\.max_iter)": INTEGER,
    r"(phys_region|imp_region|gregion)\[\d+\]\.(num_IDs|ID\[\d+\])": INTEGER,
    r"(phys_region|imp_region|gregion)\[\d+\]\.name|imp_region\[\d+\]\.im": TEXT,
    r"phys_region\[\d+\]\.ptype": "0|1|2",
    r"gregion\[\d+\]\.g_[ie][ltn]": NUMBER,
    r"gregion\[\d+\]\.dream\.vel_[ltn]": NUMBER,
    r"stim\[\d+\]\.(crct\.type|ptcl\.npls)": INTEGER,
    r"stim\[\d+\]\.elec\.vtx_file": r'"[^"]+\.vtx"',
    r"stim\[\d+\]\.(pulse\.strength|ptcl\.start|ptcl\.duration)": NUMBER,
    r"lats\[\d+\]\.(all|measurand|mode)": INTEGER,
    r"lats\[\d+\]\.ID": TEXT,
    r"lats\[\d+\]\.threshold": NUMBER,
}


def read_par(path):
    """Parameters by name, of a file that keeps to openCARP's grammar."""
    found = {}
    for line in path.read_text(encoding="ascii").splitlines():
        text = line.split("#")[0].strip()
        if not text:
            continue
        name, value = text.split(" = ")
        (kind,) = (kind for pattern, kind in GRAMMAR.items() if re.fullmatch(pattern, name))
        assert re.fullmatch(kind, value), line
        assert name not in found
        found[name] = value.strip('"')
    for counter, listed in (
        ("num_phys_regions", "phys_region"), ("num_imp_regions", "imp_region"),
        ("num_gregions", "gregion"), ("num_stim", "stim"), ("num_LATs", "lats"),
    ):  # fmt: skip
        numbers = {int(m[1]) for name in found if (m := re.match(rf"{listed}\[(\d+)\]", name))}
        assert numbers == set(range(int(found.get(counter, 0))))
    for name in [name for name in found if name.endswith("num_IDs")]:
        ids = [key for key in found if key.startswith(name.replace("num_IDs", "ID["))]
        assert len(ids) == int(found[name])
    return found


def stimulated(folder, par):
    """Vertices and times (ms) of the stimuli of a parameter file."""
    vertices, times = [], []
    for k in range(int(par["num_stim"])):
        file = folder / par[f"stim[{k}].elec.vtx_file"]
        assert file.read_text().split()[1] == "intra"
        chosen = read_vtx(file, 10**6)
        vertices += chosen.tolist()
        times += [float(par[f"stim[{k}].ptcl.start"])] * len(chosen)
    assert len(set(vertices)) == len(vertices)
    return np.array(vertices), np.array(times)


@pytest.fixture(scope="module")
def simulation(default_model):
    return default_model.simulate(LATE_LEFT)


@pytest.fixture(scope="module")
def written(default_model, simulation, tmp_path_factory):
    """A folder for each kind, with one network."""
    work = tmp_path_factory.mktemp("export")
    network = Network(LATE_LEFT, simulation, simulation.leads, 1.0, 1.0)
    for kind in ("opencarp", "vtu", "csv"):
        (work / kind).mkdir()
        write_networks(work / kind, default_model, {"000": network}, kind)
    return work


class TestOpenCarp:
    @pytest.mark.parametrize("kind", ["eikonal", "monodomain"])
    def test_parameter_files_keep_to_the_grammar_and_to_the_mesh(self, written, kind):
        folder = written / "opencarp" / "000"
        par = read_par(folder / f"{kind}.par")
        mesh = read_opencarp_mesh(folder / f"{par['meshname']}.pts")
        tags = np.unique(mesh.cell_data[TETRAHEDRON]["region"])
        listed = [int(v) for name, v in par.items() if name.startswith("gregion[0].ID[")]
        assert tags.tolist() == listed == [1]
        assert par["phys_region[0].ptype"] == {"eikonal": "2", "monodomain": "0"}[kind]
        # 3.0, 0.3, 3.0 and 1.2 mS/cm
        for name, value in (("il", 0.3), ("it", 0.03), ("in", 0.03), ("el", 0.3), ("et", 0.12)):
            assert float(par[f"gregion[0].g_{name}"]) == pytest.approx(value)
        vertices, _ = stimulated(folder, par)
        assert vertices.max() < len(mesh.points)

    def test_the_files_alone_give_the_activation(
        self, written, simulation, default_heart, default_model
    ):
        """A solver of first order, on mesh, fibres, speeds and stimuli as they were written."""
        folder = written / "opencarp" / "000"
        par = read_par(folder / "eikonal.par")
        mesh = read_opencarp_mesh(folder / f"{par['meshname']}.pts")
        fibres = mesh.cell_data[TETRAHEDRON]["fibre"]
        heart = replace(default_heart, vertices=mesh.points, fibres=fibres)
        along, across = (float(par[f"gregion[0].dream.vel_{k}"]) / 1000 for k in "lt")
        vertices, times = stimulated(folder, par)
        assert np.abs(times - simulation.activation[vertices]).max() <= STIMULUS_STEP / 2
        start = np.full(len(mesh.points), np.inf)
        start[vertices] = times
        # no rays are traced, so any table will do
        any_table = default_model.myocardium.travel_times
        conduction = conduction_for(along, across)
        myocardium = build_myocardium(heart, conduction, table=any_table)
        solved = solve_from_vertices(myocardium, start)
        late = solved - simulation.activation
        assert late.min() >= -STIMULUS_STEP / 2 - 1e-6
        assert np.abs(late).mean() < 2.0  # 1.3: point sources, of which the model has none
        assert late.max() < 10.0
        read = np.loadtxt(folder / "activation.dat")
        np.testing.assert_allclose(read, simulation.activation, atol=1e-6)

    def test_trees_come_back(self, written, simulation):
        for tree, times in zip(simulation.trees, simulation.coupled.trees, strict=True):
            stem = written / "opencarp" / "000" / f"{tree.side}_tree"
            read = read_tree(f"{stem}.pts", tree.side, tree.nodes[tree.root])
            np.testing.assert_allclose(read.nodes, tree.nodes, atol=1e-8)
            found = read_vtx(stem.with_name(f"{stem.name}_junctions.vtx"), len(tree.nodes))
            assert found.tolist() == tree.junctions.tolist()
            np.testing.assert_allclose(np.loadtxt(f"{stem}_activation.dat"), times, atol=1e-6)

    def test_scar_is_left_out_and_time_is_never_negative(self, tmp_path, monkeypatch):
        """In the middle of a block of elements of 8 mm."""
        monkeypatch.setattr(seeds, "CELLS", 10)
        block, parameters = seeds.small_heart(), seeds.parameters()
        centres = block.vertices[block.tetrahedra].mean(axis=1)
        far = np.linalg.norm(centres - seeds.SIZE / 2, axis=1)
        values = {"region_7_conductivity": 0.0, "endocardial_layer": 5.0, "endocardial_speed": 2}
        regions = np.where(far < 16, 7, 0)
        model = ForwardModel(replace(block, regions=regions, values=values | {"alpha": 0.07}))
        stimulus = Stimulus(-20.0, site="rv apex")
        simulation = model.simulate(parameters, case((stimulus,)))
        network = Network(parameters, simulation, simulation.leads, 1.0, 1.0)
        write_networks(tmp_path, model, {"best": network}, "opencarp")
        par = read_par(tmp_path / "best" / "eikonal.par")
        names = {v for k, v in par.items() if re.fullmatch(r"gregion\[\d+\]\.name", k)}
        assert names == {"region 0"}
        tags = read_opencarp_mesh(tmp_path / "heart.pts").cell_data[TETRAHEDRON]["region"]
        conducting = np.unique(tags[far >= 16])
        assert set(conducting).isdisjoint(tags[far < 16])
        assert int(par["phys_region[0].num_IDs"]) == len(conducting) > 3
        speeds = [float(v) for k, v in par.items() if k.endswith("vel_l")]
        along = 1000 * model.conduction.speeds[0]
        assert min(speeds) == pytest.approx(along, rel=0.03)
        assert max(speeds) == pytest.approx(2 * along, rel=0.03)
        written = np.loadtxt(tmp_path / "best" / "activation.dat")
        assert ((written == -1) == simulation.unreached).all()
        assert simulation.unreached.any()
        shift = -simulation.activation.min()
        assert 0 < shift <= 20
        reached = ~simulation.unreached
        np.testing.assert_allclose(written[reached] - shift, simulation.activation[reached], atol=1)
        _, times = stimulated(tmp_path / "best", par)
        assert times.min() == 0


def test_paraview(written, simulation, default_heart):
    folder = written / "vtu" / "000"
    heart = meshio.read(folder / "activation.vtu")
    np.testing.assert_array_equal(heart.point_data["activation"], simulation.activation)
    np.testing.assert_array_equal(heart.cells_dict["tetra"], default_heart.tetrahedra)
    np.testing.assert_array_equal(heart.cell_data_dict["fibre"]["tetra"], default_heart.fibres)
    points = pv.read(folder / "junctions.vtu")
    sites = pd.read_csv(folder / "sites.csv")
    assert points.n_points == points.n_cells == len(sites)
    words = {"anterograde": 1, "retrograde": -1, "never": 0}
    assert points["direction"].tolist() == sites["fired"].map(words).tolist()
    assert set(points["direction"]) == {1, -1}
    np.testing.assert_allclose(points["activation"], sites["time_ms"], atol=1e-4)
    np.testing.assert_allclose(points.points, sites[["x_mm", "y_mm", "z_mm"]], atol=1e-4)
    for tree in simulation.trees:
        lines = pv.read(folder / f"{tree.side}_tree.vtu")
        assert lines.n_cells == len(tree.nodes) - 1
        assert set(lines["direction"]) == ({1, -1} if -1 in lines["direction"] else {1})
        junctions = points["activation"][sites["tree"] == tree.side]
        np.testing.assert_array_equal(lines["activation"][tree.junctions], junctions)


def test_tables(written, simulation, default_heart, default_model):
    nodes = pd.read_csv(written / "csv" / "000" / "activation.csv")
    assert nodes.columns.tolist() == ["node", "x_mm", "y_mm", "z_mm", "time_ms"]
    np.testing.assert_allclose(nodes["time_ms"], simulation.activation, atol=1e-6)
    np.testing.assert_allclose(nodes[["x_mm", "y_mm", "z_mm"]], default_heart.vertices, atol=1e-6)
    elements = pd.read_csv(written / "csv" / "elements.csv")
    corners = elements[[f"node_{k}" for k in range(1, 5)]]
    np.testing.assert_array_equal(corners, default_heart.tetrahedra)
    fibres = elements[["fibre_x", "fibre_y", "fibre_z"]]
    np.testing.assert_allclose(fibres, default_heart.fibres, atol=1e-6)
    (tissue,) = pd.read_csv(written / "csv" / "000" / "conductivities.csv").to_dict("records")
    along, across = default_model.conduction.speeds
    assert tissue["speed_along_m_per_s"] == pytest.approx(along, rel=1e-5)
    assert tissue["speed_across_m_per_s"] == pytest.approx(across, rel=1e-5)
    assert tissue["g_et_S_per_m"] == pytest.approx(0.12)
    for tree, times in zip(simulation.trees, simulation.coupled.trees, strict=True):
        table = pd.read_csv(written / "csv" / "000" / f"{tree.side}_tree.csv")
        assert table["parent"].tolist() == tree.parents.tolist()
        np.testing.assert_allclose(table["time_ms"], times, atol=1e-6)


@pytest.fixture(scope="module")
def of_atlas(atlas_model):
    """A network on each heart of an atlas, by name, and the hearts."""
    parameters = [NETWORK | {"atlas_heart": number} for number in (0.0, 1.0)]
    beats = [atlas_model.simulate(each) for each in parameters]
    networks = {
        f"{k:03d}": Network(each, beat, beat.leads, 1.0, 1.0)
        for k, (each, beat) in enumerate(zip(parameters, beats, strict=True))
    }
    models = [atlas_model.of_heart(each) for each in parameters]
    return networks, dict(zip(networks, models, strict=True))


def test_hearts_of_an_atlas_are_with_their_networks(of_atlas, atlas_model, tmp_path):
    networks, models = of_atlas
    for kind in ("opencarp", "vtu", "csv"):
        (tmp_path / kind).mkdir()
        write_networks(tmp_path / kind, atlas_model, networks, kind)
        assert {path.name for path in (tmp_path / kind).iterdir()} == {*networks}
    for name, model in models.items():
        heart, folder = model.heart, tmp_path / "opencarp" / name
        par = read_par(folder / "eikonal.par")
        mesh = read_opencarp_mesh(folder / f"{par['meshname']}.pts")
        np.testing.assert_allclose(mesh.points, heart.vertices, atol=1e-6)
        np.testing.assert_allclose(mesh.cell_data[TETRAHEDRON]["fibre"], heart.fibres, atol=1e-5)
        along, across = model.conduction.speeds
        for side, speed in zip("lt", (along, across), strict=True):
            written = float(par[f"gregion[0].dream.vel_{side}"])
            assert written == pytest.approx(1000 * speed, rel=1e-5)
        mesh = pv.read(tmp_path / "vtu" / name / "activation.vtu")
        np.testing.assert_array_equal(mesh.points, heart.vertices)
        np.testing.assert_array_equal(mesh["fibre"], heart.fibres)
        nodes = pd.read_csv(tmp_path / "csv" / name / "activation.csv")
        np.testing.assert_allclose(nodes[["x_mm", "y_mm", "z_mm"]], heart.vertices, atol=1e-6)
        fibres = pd.read_csv(tmp_path / "csv" / name / "elements.csv").filter(like="fibre")
        np.testing.assert_allclose(fibres, heart.fibres, atol=1e-6)
    first, second = (model.conduction.speeds for model in models.values())
    assert first != second  # each heart has its tissue


def test_tissues_of_several_networks_share_tags():
    """A region that is scar in one network and slow in the other, and one that is healthy."""
    heart = block_of_random_tissue(60.0, np.random.default_rng(3))
    scarred = Conduction(regions=(Region(0.0, label=1), Region(0.5, label=2)))
    slow = Conduction(regions=(Region(0.25, label=1),), alpha=0.07)
    tags = tissue_tags(heart, [scarred, slow])
    assert len({*zip(tags, heart.regions, strict=True)}) == len(np.unique(heart.regions)) == 5
    for conduction, factors in ((scarred, {1: 0, 2: 0.5}), (slow, {1: 0.25})):
        table = tissue_table(heart, tags, conduction).set_index("region")
        for region in range(-1, 4):
            factor = factors.get(region, 1)
            assert table["g_il_S_per_m"][region] == pytest.approx(0.3 * factor)
            speed = conduction.speeds[1] * np.sqrt(factor)
            assert table["speed_across_m_per_s"][region] == pytest.approx(speed)


def test_nearest_to_the_median_by_hand():
    """Times count from the first of each; a vertex that only some reach counts among those."""
    never = np.inf
    maps = [[0, 15, 30, never], [100, 111, 120, never], [0, 5, 10, never], [0, 10, never, never]]
    maps = np.array(maps, float)
    assert nearest_to_median(maps[:3]) == 1  # the median map is 0, 11, 20
    assert nearest_to_median(maps) == 1  # 0, 10.5, 20: mean squares are 0.25/3 and 0.25/2
    assert nearest_to_median(maps[2:]) == 0  # 0, 7.5, 10: 2.5²/3 and 2.5²/2
