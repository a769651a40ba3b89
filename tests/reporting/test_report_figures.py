import subprocess
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from fascicle.reporting.figures import CAUTION_ROOM, RESOLUTION, new_figure, save


def test_saved_png_has_the_stated_resolution(tmp_path):
    path = save(new_figure(2.0, 1.0), tmp_path / "new" / "figure.png")
    header = path.read_bytes()[:24]
    assert header[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = (int.from_bytes(header[a : a + 4]) for a in (16, 20))
    assert (width, height) == (2 * RESOLUTION, RESOLUTION)


def test_a_caution_stands_above_the_figure_which_stays_as_it_was(tmp_path):
    """Also the legend, which Matplotlib would move up with the edge."""

    def drawn(name, caution=None):
        figure = new_figure(4.0, 2.0, constrained=False)
        figure.subplots().plot([0, 1], label="line")
        figure.suptitle("title", x=0.01, ha="left")
        figure.legend(loc="upper right")
        save(figure, tmp_path / name, caution)
        assert [text.get_text() for text in figure.texts] == ["title"]
        return imread(tmp_path / name)[..., :3]

    plain, marked = drawn("plain.png"), drawn("marked.png", "not to be relied on")
    above = len(marked) - len(plain)
    assert above == pytest.approx(CAUTION_ROOM * RESOLUTION, abs=1)
    assert np.abs(marked[above:] - plain).max() < 0.2
    assert (marked[:above].min(axis=2) < 0.5).mean() > 0.01  # the line
    assert marked[0, -1].min() == 1.0  # on white


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = save(new_figure(1.0, 1.0), tmp_path / "figure.png")
    before = path.read_bytes()

    def fail(self, temporary, **options):
        temporary.write_bytes(b"half a fig")
        raise OSError("disk full")

    monkeypatch.setattr(Figure, "savefig", fail)
    with pytest.raises(OSError, match="disk full"):
        save(new_figure(2.0, 2.0), path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["figure.png"]


def test_importing_the_package_loads_no_matplotlib_and_the_figures_no_pyplot():
    program = (
        "import sys, fascicle.reporting; assert 'matplotlib' not in sys.modules;"
        "import fascicle.reporting.ecg, fascicle.reporting.hearts, fascicle.reporting.pairs;"
        "assert 'matplotlib.pyplot' not in sys.modules; assert 'vtkmodules' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
