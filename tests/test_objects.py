"""Objects that show themselves: in figures, notebooks, PyVista, and files that are read back."""

import ast
import base64
import io
import re
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot

import fascicle
from benchmarks.fits import demo_recording
from fascicle.core.errors import InputError

SOURCE = Path(fascicle.__file__).parent


@pytest.fixture(scope="module")
def simulation(default_model):
    return default_model.simulate(fascicle.example_parameters(default_model))


@pytest.fixture(scope="module")
def target():
    return fascicle.make_target(fascicle.read_recording(demo_recording()))


@pytest.fixture(autouse=True)
def closed():
    yield
    pyplot.close("all")


def looked_up():
    """Where, and which function of which module above, ``above("module").function`` names."""
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Call):
                call = node.value
                if isinstance(call.func, ast.Name) and call.func.id == "above":
                    yield path, ast.literal_eval(call.args[0]), node.attr


def test_what_is_looked_up_above_is_there():
    found = list(looked_up())
    assert len(found) > 15
    for _, module, function in found:
        assert callable(getattr(import_module(f"fascicle.{module}"), function))


def facts(card):
    """Facts of a card, and its picture."""
    rows = re.findall(r"<th[^>]*>(.*?)</th><td[^>]*>(.*?)</td>", card)
    picture = re.search(r'src="data:image/png;base64,([^"]+)"', card)
    return dict(rows), pyplot.imread(io.BytesIO(base64.b64decode(picture[1])))


# Prints a heart's card, and what had been loaded that the import before it does not need
PROGRAM = """
import sys
def loaded(*names):
    print([name for name in names if name in sys.modules])
import fascicle.cli.commands
loaded("numpy")
import fascicle.study.study
loaded("scipy.stats", "fascicle.inference.gaussian_process")
from fascicle import FittedStudy, Predicted, PurkinjeTree, Beat, load_heart, read_target
heart = load_heart("default")
heart.plot, heart.save
import fascicle.reporting
loaded("matplotlib", "pyvista")
import fascicle.reporting.ecg, fascicle.reporting.activation
loaded("matplotlib.pyplot", "vtkmodules")
card = heart._repr_html_()
from matplotlib import pyplot
print(pyplot.get_fignums())
print(card)
"""


def test_nothing_is_drawn_or_loaded_before_it_is_asked_for():
    """In a fresh process without a display, which draws a heart and says nothing."""
    clean = {"PATH": "/usr/bin:/bin", "HOME": "/tmp", "PYTHONPATH": ":".join(sys.path)}
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=clean, capture_output=True, text=True
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    *lists, card = ended.stdout.split("\n", 5)
    assert lists == ["[]"] * 5
    assert facts(card)[1][..., :3].std() > 0.02, "the picture is blank"


def test_cards_state_facts_with_units_and_show_a_picture(default_heart, simulation, target):
    cards = [
        (default_heart, "volume of the myocardium", f"{default_heart.volumes.sum() / 1000:.0f} ml"),
        (simulation.trees[0], "junctions", str(len(simulation.trees[0].junctions))),
        (simulation, "QRS duration", f"{simulation.qrs_duration:.0f} ms"),
        (target, "beats", str(len(target.beats))),
    ]
    for shown, name, value in cards:
        said, picture = facts(shown._repr_html_())
        assert said[name] == value
        assert picture[..., :3].std() > 0.02, "the picture is blank"
    spoilt = replace(target, provenance={"source": "<script>alert(1)</script>"})
    assert "<script>" not in spoilt._repr_html_()
    assert "&lt;script&gt;" in spoilt._repr_html_()


def test_what_is_saved_is_read_back(default_heart, simulation, target, tmp_path):
    default_heart.save(tmp_path / "heart")
    assert fascicle.load_heart(tmp_path / "heart").digest == default_heart.digest
    target.save(tmp_path / "target.nc")
    np.testing.assert_array_equal(fascicle.read_target(tmp_path / "target.nc").beats, target.beats)
    tree = simulation.trees[1]
    tree.save(tmp_path / "rv.vtu")
    simulation.save(tmp_path / "simulation", default_heart)
    for path in (tmp_path / "rv.vtu", tmp_path / "simulation" / "rv_tree.vtu"):
        again = fascicle.read_tree(path, "rv")
        assert again.root == tree.root
        np.testing.assert_array_equal(again.parents, tree.parents)
        np.testing.assert_allclose(again.lengths, tree.lengths)
    assert (tmp_path / "simulation" / "ecg.csv").exists()
    with pytest.raises(InputError, match="path is None"):
        tree.save(None)


def test_pyvista_gets_named_arrays_with_units(default_heart, simulation):
    blocks = simulation.to_pyvista(default_heart)
    assert set(blocks.keys()) == {"lv_tree", "rv_tree", "junctions", "heart"}
    np.testing.assert_array_equal(blocks["heart"]["activation_ms"], simulation.activation)
    assert "heart" not in simulation.to_pyvista().keys()  # noqa: SIM118 - not a mapping
    tree = simulation.trees[0].to_pyvista(simulation.coupled.trees[0])
    assert tree["length_mm"].sum() == pytest.approx(simulation.trees[0].lengths.sum())
    assert set(simulation.trees[0].to_pyvista().array_names) == {"root", "length_mm"}
    heart = default_heart.to_pyvista()
    fields = default_heart.lead_fields.values
    np.testing.assert_array_equal(heart["lead_field_V6_kohm"], fields[-1])
    assert heart.compute_cell_sizes()["Volume"].sum() == pytest.approx(default_heart.volumes.sum())


def test_objects_draw_into_the_user_s_axes(default_heart, simulation):
    figure = pyplot.figure()
    flat, deep = figure.add_subplot(121), figure.add_subplot(122, projection="3d")
    assert default_heart.plot("base", flat) == [flat]
    assert simulation.trees[0].plot(deep) == [deep]
    assert len(flat.images) == 1
    points = np.concatenate([np.column_stack(line.get_data_3d()) for line in deep.lines])
    assert {*map(tuple, simulation.trees[0].nodes)} <= {*map(tuple, points)}
    assert pyplot.get_fignums() == [figure.number]
    with pytest.raises(InputError, match="two dimensions"):
        simulation.trees[0].plot(flat)
    with pytest.raises(InputError, match="view is 'top'; give one of RV side"):
        default_heart.plot("top")
    axes = simulation.plot()
    np.testing.assert_array_equal(axes[0].lines[0].get_ydata(), simulation.leads[0])
    *panels, bar = simulation.plot(default_heart)
    assert len(panels) == 6
    assert bar.get_ylabel() == "activation (ms)"


def test_settings_of_the_user_count(target):
    """Where a report has a look of its own (`tests/reporting/test_style.py`)."""
    size = target.plot()[0].figure.get_size_inches()
    assert tuple(size) != tuple(matplotlib.rcParamsDefault["figure.figsize"])
    mine = {"figure.figsize": (5.0, 7.0), "figure.dpi": 61, "font.size": 17, "axes.linewidth": 3}
    with pyplot.rc_context(mine):
        axes = target.plot()[0]
        assert tuple(axes.figure.get_size_inches()) == (5, 7)
        assert axes.figure.dpi == 61
        assert axes.texts[0].get_fontsize() == 17
        assert axes.yaxis.get_ticklabels()[0].get_fontsize() == 17
        assert axes.spines["left"].get_linewidth() == 3
        assert not axes.spines["top"].get_visible()  # which was not set


def test_indices_are_a_table_with_units(default_heart, simulation):
    table = simulation.index_table(default_heart, stimulus=0.0)
    assert list(table.columns) == ["value", "unit", "name"]
    total = table.loc["total_activation_time"]
    assert list(total) == [simulation.total_activation_time, "ms", "total activation time"]
    assert table.loc["qrs_area", "unit"] == "µVs"
    since = table["value"]["qrs_from_stimulus"] - table["value"]["qrs_duration"]
    assert since > simulation.onset
    assert np.isnan(simulation.index_table(default_heart)["value"]["qrs_from_stimulus"])
