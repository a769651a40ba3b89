"""What depends on a heart alone is kept on disk: read back the same, and never in the way."""

import os
from dataclasses import replace

import numpy as np
import pytest
from anatomies import NETWORK

from benchmarks.references import Upstroke
from fascicle.core.errors import InputError
from fascicle.core.files import DISPOSABLE, ArrayCache
from fascicle.forward import preparation
from fascicle.forward.eikonal import build as eikonal_build
from fascicle.forward.model import ForwardModel
from fascicle.forward.preparation import prepare
from fascicle.heart.conduction import Conduction, Region
from fascicle.heart.folder import load_heart, write_heart


@pytest.fixture
def built(monkeypatch):
    """How often anything is built from now on."""
    calls, build = [], preparation.build

    def spy(*args):
        calls.append(args)
        return build(*args)

    monkeypatch.setattr(preparation, "build", spy)
    return calls


@pytest.fixture
def heart(tmp_path):
    """Four tetrahedra, as if read from a folder."""
    return replace(preparation._smallest_heart(), folder=tmp_path)


def kept(heart):
    return sorted((heart.folder / DISPOSABLE).glob("*"))


def assert_same(one, other):
    """The mesh, the rays, the charts, the ECG integral: all that is kept."""
    np.testing.assert_equal(preparation.as_arrays(one), preparation.as_arrays(other))
    assert [s.triangle for s in one.seeds.values()] == [s.triangle for s in other.seeds.values()]


class TestCache:
    def test_second_time_it_is_read(self, heart, built):
        first = prepare(heart, Conduction(), Upstroke())
        assert (len(built), len(kept(heart))) == (1, 1)
        second = prepare(heart, Conduction(), Upstroke())
        assert (len(built), len(kept(heart))) == (1, 1)
        assert_same(first, second)

    @pytest.mark.parametrize(
        "change",
        [
            {"fibres": np.tile([0.0, 1.0, 0.0], (4, 1))},
            {"electrodes": np.full((9, 3), 70.0)},
            {"regions": np.array([0, 0, 1, 1])},
        ],
        ids=lambda change: next(iter(change)),
    )
    def test_another_heart_has_another_key(self, heart, built, change):
        prepare(heart, Conduction(), Upstroke())
        prepare(replace(heart, **change), Conduction(), Upstroke())
        assert (len(built), len(kept(heart))) == (2, 2)

    @pytest.mark.parametrize(
        "conduction",
        [
            Conduction(alpha=0.06),
            Conduction(torso=1.0),
            Conduction(regions=(Region(0.5, centre=(0.0, 0.0, 0.0), radius=50.0),)),
        ],
        ids=["alpha", "torso", "region"],
    )
    def test_another_conduction_has_another_key(self, heart, built, conduction):
        plain = prepare(heart, Conduction(), Upstroke())
        other = prepare(heart, conduction, Upstroke())
        assert (len(built), len(kept(heart))) == (2, 2)
        with pytest.raises(AssertionError):
            assert_same(plain, other)

    def test_names_and_places_are_no_part_of_the_key(self, heart, built):
        """What a heart is called, or which file a region came from, changes no number."""
        region = Region(0.5, centre=(0.0, 0.0, 0.0), radius=50.0)
        prepare(heart, Conduction(regions=(region,)), Upstroke())
        named = replace(region, source="case.toml")
        prepare(replace(heart, name="other"), Conduction(regions=(named,)), Upstroke())
        assert len(built) == 1

    @pytest.mark.parametrize(
        "damage",
        [
            lambda file: file.write_bytes(file.read_bytes()[:-500]),
            lambda file: file.write_bytes(
                file.read_bytes()[:3000] + b"\xff" * 200 + file.read_bytes()[3200:]
            ),
            lambda file: np.savez(file, nothing=np.array([{"a": 1}])),
        ],
        ids=["truncated", "garbled", "pickle"],
    )
    def test_a_damaged_file_is_made_again(self, heart, built, damage):
        first = prepare(heart, Conduction(), Upstroke())
        damage(kept(heart)[0])
        again = prepare(heart, Conduction(), Upstroke())
        assert len(built) == 2
        assert_same(first, again)
        assert_same(first, prepare(heart, Conduction(), Upstroke()))
        assert (len(built), len(kept(heart))) == (2, 1)

    def test_only_a_few_files_stay(self, heart, built):
        speeds = [Conduction(alpha=0.05 + 0.01 * k) for k in range(6)]
        for moment, conduction in enumerate(speeds):
            prepare(heart, conduction, Upstroke())
            newest = max(kept(heart), key=lambda file: file.stat().st_mtime_ns)
            os.utime(newest, (1e9 + moment, 1e9 + moment))  # file systems' clocks are coarse
            assert len(kept(heart)) == min(moment + 1, 4)
        prepare(heart, speeds[-1], Upstroke())
        assert len(built) == 6
        prepare(heart, speeds[0], Upstroke())
        assert len(built) == 7


class TestWithoutCache:
    def test_no_folder(self, heart, built):
        for _ in range(2):
            prepare(replace(heart, folder=None), Conduction(), Upstroke())
        assert len(built) == 2
        assert kept(heart) == []

    def test_folder_that_is_read_only(self, heart, built, monkeypatch):
        monkeypatch.setattr("os.access", lambda path, mode: False)
        prepare(heart, Conduction(), Upstroke())
        assert len(built) == 1
        assert list(heart.folder.iterdir()) == []

    def test_a_file_in_the_cache_s_place(self, heart, built):
        (heart.folder / DISPOSABLE).write_text("mine")
        prepare(heart, Conduction(), Upstroke())
        assert len(built) == 1
        assert (heart.folder / DISPOSABLE).read_text() == "mine"

    def test_a_cache_that_cannot_be_written(self, heart, built, monkeypatch):
        def fail(*_):
            raise OSError(28, "full")

        monkeypatch.setattr(ArrayCache, "write", fail)
        prepared = prepare(heart, Conduction(), Upstroke())
        assert_same(prepared, preparation.build(heart, Conduction(), Upstroke()))

    def test_a_file_that_another_process_takes_away(self, heart, built, monkeypatch):
        """Between listing and looking at it."""
        prepare(heart, Conduction(), Upstroke())
        gone = heart.folder / DISPOSABLE / "prepared-gone.npz"
        gone.symlink_to(heart.folder / "nowhere.npz")
        prepare(heart, Conduction(alpha=0.06), Upstroke())
        assert len(built) == 2

    def test_the_packaged_heart_keeps_nothing_in_the_package(self, monkeypatch, tmp_path):
        monkeypatch.setenv("FASCICLE_CACHE", str(tmp_path / "cache"))
        assert load_heart("default").folder == tmp_path / "cache" / "hearts" / "default"


class TestRealHeart:
    @pytest.fixture(scope="class")
    def folder(self, small_heart, tmp_path_factory):
        folder = tmp_path_factory.mktemp("hearts") / "adult"
        write_heart(small_heart, folder)
        return folder

    def test_simulations_are_bitwise_the_same(self, folder, built):
        simulations = [ForwardModel(load_heart(folder)).simulate(NETWORK) for _ in range(2)]
        assert len(built) == 1
        one, other = simulations
        np.testing.assert_array_equal(one.activation, other.activation)
        np.testing.assert_array_equal(one.ecg.to_numpy(), other.ecg.to_numpy())
        np.testing.assert_array_equal(one.coupled.origin, other.coupled.origin)
        for tree, same in zip(one.trees, other.trees, strict=True):
            np.testing.assert_array_equal(tree.nodes, same.nodes)

    def test_writing_over_it_is_allowed_and_begins_anew(self, folder, small_heart, built):
        """The cache may be lost; the reader's own files may not."""
        prepare(load_heart(folder), Conduction(), Upstroke())
        assert (folder / DISPOSABLE).is_dir()
        write_heart(small_heart, folder)
        assert not (folder / DISPOSABLE).exists()
        (folder / "notes.txt").write_text("mine")
        with pytest.raises(InputError, match=r"notes\.txt"):
            write_heart(small_heart, folder)
        (folder / "notes.txt").unlink()


class TestCompilation:
    @pytest.fixture(autouse=True)
    def not_yet(self, monkeypatch):
        """As in a process that has compiled nothing."""
        monkeypatch.setattr(preparation, "_compiled", False)

    def test_says_nothing_where_nothing_is_slow(self, monkeypatch):
        preparation.compile_kernels(lambda *_: None)  # now everything is compiled
        monkeypatch.setattr(preparation, "_compiled", False)
        reports = []
        preparation.compile_kernels(lambda *what: reports.append(what), silence=60.0)
        assert reports == []

    def test_reports_progress_where_it_takes_long(self, monkeypatch):
        reports, steps = [], preparation._steps

        def slow_steps():
            import time

            time.sleep(0.1)
            yield from steps()

        monkeypatch.setattr(preparation, "_steps", slow_steps)
        preparation.compile_kernels(lambda *what: reports.append(what), silence=0.0)
        assert [what[:3] for what in reports] == [("compilation", done, 4) for done in range(5)]

    def test_leaves_no_timer_behind_when_it_fails(self, monkeypatch):
        import threading

        def broken():
            raise RuntimeError("no compiler")
            yield

        monkeypatch.setattr(preparation, "_steps", broken)
        before, reports = threading.active_count(), []
        with pytest.raises(RuntimeError, match="no compiler"):
            preparation.compile_kernels(lambda *what: reports.append(what))
        for thread in threading.enumerate():
            if isinstance(thread, threading.Timer):
                thread.join(2.0)
        assert threading.active_count() <= before
        assert reports == []


def test_a_copy_of_a_heart_is_not_prepared_again(built, heart, tmp_path):
    conduction, template = Conduction(), Upstroke()
    first = prepare(heart, conduction, template)
    (kept(heart)[0].parent / ".prepared-half.npz").write_text("being written")
    copied = replace(heart, folder=tmp_path / "copy")
    copied.folder.mkdir()
    preparation.share_prepared(heart, copied.folder)
    preparation.share_prepared(heart, copied.folder)  # as a study that goes on does
    assert_same(prepare(copied, conduction, template), first)
    assert len(built) == 1
    assert [file.name for file in kept(copied)] == [kept(heart)[1].name]


def test_what_cannot_be_linked_is_left(heart, tmp_path, monkeypatch):
    prepare(heart, Conduction(), Upstroke())

    def refuse(*_):
        raise OSError(18, "another disk")

    monkeypatch.setattr(os, "link", refuse)
    (tmp_path / "copy").mkdir()
    preparation.share_prepared(heart, tmp_path / "copy")
    assert not any((tmp_path / "copy" / DISPOSABLE).iterdir())


def test_tissues_are_kept_where_that_is_asked_for(heart, monkeypatch):
    traced, trace = [], eikonal_build.build_travel_time_table

    def spy(*args):
        traced.append(args)
        return trace(*args)

    monkeypatch.setattr(eikonal_build, "build_travel_time_table", spy)
    found = []
    for tables in (3, 1):  # the plain tissue's, too, at first
        traced.clear()
        model = ForwardModel(heart, action_potential=Upstroke())
        model.keep_tissues([{"anisotropy_ratio": 2.0}])
        ratios = [replace(model.conduction, anisotropy_ratio=ratio) for ratio in (2.0, 2.2)]
        found.append([model._tissue(each).myocardium for each in ratios])
        assert len(traced) == tables
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one.travel_times.square, other.travel_times.square)
        np.testing.assert_array_equal(one.mesh.solver, other.mesh.solver)
        # a kernel would be compiled again for an array without dimensions
        assert isinstance(other.travel_times.reach, float)
    assert not np.allclose(found[0][0].mesh.solver, found[0][1].mesh.solver)
    alone = ForwardModel(heart, ratios[1], action_potential=Upstroke()).myocardium
    for name, array in alone.mesh._asdict().items():  # nothing of the plain tissue is in it
        np.testing.assert_array_equal(getattr(found[0][1].mesh, name), array, err_msg=name)
