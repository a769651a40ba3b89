"""The look that figures share, and the way to disk."""

import warnings

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from fascicle.core.errors import InputError
from fascicle.reporting import style


@style.styled
def figure_of(title=""):
    figure = style.new_figure(4.0, 2.0, title)
    figure.subplots().plot([0, 1], label="line")
    style.legend(figure, [(figure.axes[0].lines[0], "line")])
    return figure


def test_figures_have_one_look_whatever_the_user_s_settings(tmp_path):
    plain = imread(style.save(figure_of("title"), tmp_path / "plain.png"))
    with matplotlib.rc_context({"font.size": 30, "axes.spines.top": True}):
        other = imread(style.save(figure_of("title"), tmp_path / "other.png"))
        assert matplotlib.rcParams["font.size"] == 30
    assert plain.shape == (100, 200, 4)  # a third of 150 dots per inch (`coarse_pictures`)
    np.testing.assert_array_equal(plain, other)


def test_a_caution_stands_above_title_and_legend():
    figure = style.mark(figure_of("title"), "not to be relied on")
    assert figure.get_suptitle() == "not to be relied on\ntitle"
    figure.canvas.draw()
    title, legend = figure._suptitle.get_window_extent(), figure.legends[0].get_window_extent()
    assert not title.overlaps(legend)
    assert legend.y0 > figure.axes[0].get_window_extent().y1
    assert style.mark(figure_of("title"), None).get_suptitle() == "title"


def test_long_titles_are_wrapped_and_names_are_no_formulas(tmp_path):
    figure = figure_of("a $title$ of many words " * 12)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        style.save(figure, tmp_path / "a.pdf")
        style.save(figure_of("心电图 $5^{ & <b>$"), tmp_path / "b.svg")
    figure.canvas.draw()
    box = figure._suptitle.get_window_extent()
    assert box.x1 <= figure.bbox.width
    assert box.y0 > figure.axes[0].get_window_extent().y1
    assert style.short("  a\nb\t c ") == "a b c"
    assert style.short("x" * 30 + "y" * 30, 20) == "x" * 10 + "…" + "y" * 9
    assert style.signed(-3.4) == "\N{MINUS SIGN}3"


@pytest.mark.parametrize("name", ["a.jpg", "a"])
def test_unknown_formats_are_refused(tmp_path, name):
    with pytest.raises(InputError, match=r"\.svg"):
        style.save(figure_of(), tmp_path / name)


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = style.save(figure_of(), tmp_path / "figure.png")
    before = path.read_bytes()

    def fail(self, temporary, **options):
        temporary.write_bytes(b"half a fig")
        raise OSError("disk full")

    monkeypatch.setattr(Figure, "savefig", fail)
    with pytest.raises(OSError, match="disk full"):
        style.save(figure_of(), path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["figure.png"]
