"""What every command takes: --quiet, --json, --log, --allow-outside; progress in plain lines."""

import io
import json
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest
from rich.progress import Progress as Bars

from fascicle.cli.commands import documentation
from fascicle.cli.output import Output, TerminalProgress, _as_json
from fascicle.core.errors import ValueRefusedError
from fascicle.core.progress import ProgressLines, shown_progress, time_left, write_with_time
from fascicle.prediction.index_names import COMPARED, INDICES

pytestmark = pytest.mark.usefixtures("blank_pictures")
COMMANDS = {  # with something of their help
    "simulate": "--root-time", "target": "--out", "parameters": "--free", "fit": "--effective",
    "predict": "--scenario", "compare": "--threshold", "sweep": "--delay", "scenarios": "copy",
    "locate": "17 segments", "states": "without a fit", "docs": "pages",
    "explore": "Only this machine",
    "report": "Finished study", "cohort": "--only", "template": "--out", "demo": "--out",
    "heart build": "--lv-endocardium", "heart import": "--lv-endocardium", "heart check": "HEART",
    "heart refine": "--out", "heart add-electrodes": "V2R", "heart simulate-prior": "--networks",
    "heart export": "openCARP",
    "study show": "Finished study", "study compare": "STUDY",
    "study export": "openCARP",
}  # fmt: skip
STAMP = r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d "


@pytest.mark.parametrize("command", COMMANDS)
def test_the_options_of_every_command(run, monkeypatch, command):
    monkeypatch.setenv("COLUMNS", "100")
    ended = run(*command.split(), "--help")
    assert (ended.status, ended.err) == (0, "")
    for words in ("--quiet", "--json", "--log", "--allow-outside", COMMANDS[command]):
        assert words in ended.out


@pytest.mark.parametrize(
    "asked",
    ["fit default t.nc --out o", "predict . --out o", "compare . his-pacing intrinsic",
     "sweep . biventricular-pacing --out o --delay=-10:10:10", "report .",
     "heart simulate-prior default", "locate default t.nc --out o", "states default t.nc"],
)  # fmt: skip
def test_what_simulates_many_networks_may_do_so_on_a_cluster(refused, asked):
    refused([*asked.split(), "--scheduler", "here"], "'here' is not an address of a Dask scheduler")


def test_threads_may_show_a_stage_at_the_same_time():
    """Networks that are trained in parallel begin it together."""
    for _ in range(20):
        lines, threads = ProgressLines(lambda line: None), 8
        together = Barrier(threads)

        def show(number, lines=lines, together=together):
            together.wait()
            lines("training", number, 10, "")

        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(show, range(threads)))
        assert len(lines._bars.tasks) == 1
        lines.end()


@pytest.mark.parametrize("command", ["compare", "sweep"])
def test_help_lists_the_indices_with_their_units(run, monkeypatch, command):
    monkeypatch.setenv("COLUMNS", "100")
    said = re.sub(r"[\s│]+", " ", run(command, "--help").out)
    assert f"{', '.join(f'{name} ({INDICES[name]})' for name in COMPARED)}." in said


def test_an_unknown_index_names_those_there_are(refused, tmp_path):
    said = refused(["compare", tmp_path, "a", "b", "--index", "qrs"], "'qrs' is not compared")
    assert all(name in said for name in COMPARED)


def test_there_are_no_other_commands():
    import typer.main

    from fascicle.cli.commands import app

    root = typer.main.get_command(app)
    found = []
    for name, command in root.commands.items():
        inner = getattr(command, "commands", None)
        found += [name] if inner is None else [f"{name} {each}" for each in inner]
    assert sorted(found) == sorted(COMMANDS)


@pytest.fixture
def heart(ventricles):
    return ventricles


def test_json_is_all_that_is_printed(run, heart, tmp_path):
    out = tmp_path / "s"
    ended = run("simulate", heart, "--out", out, "--json")
    assert ended.well
    found = json.loads(ended.out)
    written = json.loads((out / "summary.json").read_text())
    pictures = [str(out / f"{name}.png") for name in ("ecg", "activation")]
    assert found == {"folder": str(out), "pictures": pictures} | written
    assert json.loads(run("scenarios", "--json").out)["his-pacing"]
    names = [each["name"] for each in json.loads(run("parameters", "--json").out)]
    assert "cv" in names
    picture = "--picture", tmp_path / "check.png"
    assert json.loads(run("heart", "check", heart, "--json", *picture).out)["warnings"] == []


def test_quiet_is_silent(run, heart, tmp_path):
    ended = run("simulate", heart, "--out", tmp_path / "s", "--quiet")
    assert (ended.status, ended.out, ended.err) == (0, "", "")
    assert (tmp_path / "s" / "ecg.csv").exists()


def test_log_holds_what_was_said_with_times(run, refused, heart, tmp_path):
    log = tmp_path / "a.log"
    shown = run("simulate", heart, "--out", tmp_path / "s", "--log", log).out
    refused(["simulate", heart, "--out", tmp_path / "t", "--cv", "-1", "--log", log], "--cv")
    lines = log.read_text().splitlines()
    assert all(re.match(STAMP, line) for line in lines)
    said = [re.sub(STAMP, "", line, count=1) for line in lines]
    assert said[0].startswith("fascicle simulate ")
    assert said[1 : 1 + len(shown.splitlines())] == shown.splitlines()
    assert said[-1].startswith("error: --cv")


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ("nowhere t.nc", "nowhere: no such heart folder"),
        ("default none.nc", "none.nc: no such file"),
        ("default notes.txt", "notes.txt: "),
        ("default t.nc", "t.nc: not a readable netCDF file"),
        ("default t.nc --settings none.toml", "none.toml: no such file"),
        ("default t.nc --settings wrong.toml", "wrong.toml: parameter 'cv': unknown key 'low'"),
    ],
)
def test_states_refuse_what_cannot_be_used(refused, tmp_path, monkeypatch, asked, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "notes.txt").write_text("nothing")
    (tmp_path / "t.nc").write_text("nothing")
    (tmp_path / "wrong.toml").write_text("[parameters]\ncv = { low = 1.5 }\n")
    refused(["states", *asked.split()], words)
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["notes.txt", "t.nc", "wrong.toml"]


def test_states_refuse_counts_of_none(run):
    for option in ("--prior-simulations", "--workers"):
        ended = run("states", "default", "t.nc", option, 0)
        assert (ended.status, ended.out) == (2, "")
        assert option in ended.err


def test_the_file_of_a_scenario_is_printed(run, refused, tmp_path):
    assert 'site = "left bundle"' in run("scenarios", "left-bundle-branch-pacing").out
    refused(["scenarios", tmp_path / "none.toml"], "no such file")
    refused(["scenarios", "his-pacin"], "did you mean 'his-pacing'")
    refused(["scenarios", "LBBB"], "did you mean 'left-bundle-branch-block'?")
    refused(["scenarios", "nothing-like-it"], "no scenario 'nothing-like-it'; 'fascicle scenarios'")


def test_log_that_cannot_be_written(refused, tmp_path):
    refused(["scenarios", "--log", tmp_path], tmp_path, "--log")


def test_plain_json():
    given = {"a": np.array([1.0, np.nan]), 2: np.float32(0.5), "p": Path("x"), "t": (1, "b")}
    assert json.loads(_as_json(given)) == {"a": [1.0, None], "2": 0.5, "p": "x", "t": [1, "b"]}


class TestProgress:
    """Without a terminal, but for bars."""

    @pytest.fixture
    def progress(self, tmp_path):
        path = tmp_path / "screen"
        with path.open("w") as screen:
            say = partial(write_with_time, stream=screen)
            progress = ProgressLines(say, first=0.05, interval=0.2)
            yield progress, path.read_text
            progress.end()

    def test_lines_appear_while_it_runs(self, progress):
        report, said = progress
        for done in range(11):
            report("sampling", done, 10, "all well")
            time.sleep(0.05)
        lines = said().splitlines()
        assert 3 <= len(lines) <= 5  # the first, at most two between, the last
        assert re.fullmatch(r"\d\d:\d\d:\d\d sampling \d/10, 0 s.*: all well", lines[0])
        assert "sampling 10/10" in lines[-1]

    def test_a_stage_that_says_nothing_is_named(self, progress):
        report, said = progress
        report("compilation", 0, 1, "")
        time.sleep(0.2)
        assert "compiling (first run) 0/1" in said()

    def test_what_is_done_soon_is_not_spoken_of(self, progress):
        report, said = progress
        for done in range(3):
            report("preparation", done, 2, "")
        time.sleep(0.1)
        assert said() == ""

    def test_bars_begin_again_with_another_patient(self, monkeypatch):
        monkeypatch.setattr("rich.console.Console.is_terminal", True)
        screen = io.StringIO()
        with TerminalProgress(Output(screen)) as progress:
            progress("sampling", 5, 10, "")
            (bar,) = progress._bars.tasks
            began = bar.start_time
            progress("sampling", 10, 10, "")
            assert bar.start_time == began
            assert bar.finished
            progress("sampling", 1, 20, "")
            assert (bar.completed, bar.total) == (1, 20)
            assert bar.start_time > began
            assert not bar.finished
        assert "sampling" in screen.getvalue()

    def test_python_shows_lines_unless_told_otherwise(self, capsys):
        with shown_progress("lines") as progress:
            assert isinstance(progress, ProgressLines)
        with shown_progress(None) as progress:
            assert progress is None
        own = ProgressLines(lambda line: None)
        with shown_progress(own) as progress:
            assert progress is own
        assert not own._over.is_set()  # goes on with what its owner does next
        with shown_progress(print) as progress:
            assert progress is print
        with pytest.raises(ValueRefusedError, match="progress is 5"):  # noqa: SIM117
            with shown_progress(5):
                pass

    @pytest.mark.parametrize(
        ("steps", "left"),
        [
            ([(1, 0)], ""),  # no pace yet
            ([(1, 7010), (10, 7100)], "4 min 50 s left"),  # what was done before does not count
            ([(100, 7300), (200, 7600)], "13 min left"),  # steps that are far apart
            ([(10, 10_000)], ""),
        ],
    )
    def test_time_left_by_a_clock(self, steps, left):
        now = [0.0]
        bars = Bars(disable=True, speed_estimate_period=60.0, get_time=lambda: now[0])
        number = bars.add_task("networks", total=10_000, message="", first=7000)
        bars.update(number, completed=7000)
        for now[0], done in steps:
            bars.update(number, completed=done)
        assert time_left(bars.tasks[0]) == left


class TestOutside:
    """A file from somebody else does not choose what is read."""

    @pytest.fixture
    def secret(self, tmp_path):
        path = tmp_path / "elsewhere" / "secret.csv"
        path.parent.mkdir()
        path.write_text("token,abc123\n")
        return path

    @pytest.mark.parametrize(
        ("part", "how"),
        [("electrodes", ".."), ("electrodes", "link"), ("mesh", "absolute"), ("mesh", "null")],
    )
    def test_of_a_heart(self, run, refused, heart, secret, tmp_path, part, how):
        copied = shutil.copytree(heart, tmp_path / "h")
        (copied / "linked.csv").symlink_to(secret)
        named = {
            "..": "../elsewhere/secret.csv", "absolute": str(secret), "link": "linked.csv",
            "null": "a\\\\u0000b",
        }[how]  # fmt: skip
        manifest = copied / "heart.toml"
        text = re.sub(rf'(?m)^{part} = ".*"', f'{part} = "{named}"', manifest.read_text())
        manifest.write_text(text)
        words = "no file" if how == "null" else "outside its folder"
        assert "abc123" not in refused(["heart", "check", copied], manifest, words)
        if how != "null":
            ended = run("heart", "check", copied, "--allow-outside")
            assert "outside its folder" not in ended.err
            assert ended.status == 2  # it is read, and is no electrodes and no mesh

    def test_what_is_allowed_works(self, run, heart, tmp_path):
        copied = shutil.copytree(heart, tmp_path / "h")
        shutil.move(copied / "electrodes.csv", tmp_path / "electrodes.csv")
        (copied / "electrodes.csv").symlink_to(tmp_path / "electrodes.csv")
        assert run("heart", "check", copied).status == 2
        assert run("heart", "check", copied, "--allow-outside").status == 0
        (tmp_path / "linked").symlink_to(heart)  # which is a heart
        picture = "--picture", tmp_path / "a.png"
        assert run("heart", "check", tmp_path / "linked", *picture).status == 0

    def test_of_a_scenario(self, refused, heart, secret, tmp_path):
        (tmp_path / "s").mkdir()
        scenario = tmp_path / "s" / "s.toml"
        scenario.write_text(
            '[[tree]]\nname = "band"\nfile = "../elsewhere/secret.vtu"\n'
            "time = 0\nroot = [0, 0, 0]\n"
        )
        secret.rename(secret.with_suffix(".vtu"))
        command = ["simulate", heart, "--out", tmp_path / "o", "--scenario", scenario]
        refused(command, scenario, "outside its folder")

    def test_of_a_segmentation(self, run, refused, secret, tmp_path):
        import nrrd

        folder = tmp_path / "s"
        folder.mkdir()
        path = folder / "a.nhdr"
        labels = np.zeros((4, 4, 4), np.uint8)
        nrrd.write(str(path), labels, {"encoding": "raw", "space": "LPS",
                                       "space directions": np.eye(3)})  # fmt: skip
        shutil.move(folder / "a.raw", tmp_path / "elsewhere" / "a.raw")
        path.write_text(path.read_text().replace("a.raw", "../elsewhere/a.raw"))
        said = refused(["heart", "build", path, "--out", tmp_path / "h"], path)
        assert "outside its folder" in said
        ended = run("heart", "build", path, "--out", tmp_path / "h", "--allow-outside")
        assert "outside its folder" not in ended.err

    def test_message_shows_nothing_of_what_is_refused(self, refused, heart, tmp_path):
        copied = shutil.copytree(heart, tmp_path / "h")
        (copied / "heart.toml").unlink()
        (tmp_path / "shadow").write_text("root:$6$secret:1\n")
        (copied / "heart.toml").symlink_to(tmp_path / "shadow")
        assert "secret" not in refused(["heart", "check", copied], "heart.toml")


@pytest.fixture
def read_only(monkeypatch):
    """Make folders look as if nobody may write there: root, as which tests may run, always may."""
    closed = []
    really = os.access

    def access(path, mode):
        return really(path, mode) and not (mode & os.W_OK and Path(path) in closed)

    monkeypatch.setattr("fascicle.core.files.os.access", access)
    return closed.append


def test_heart_check_of_a_folder_that_cannot_be_written(run, refused, heart, read_only, tmp_path):
    copied = shutil.copytree(heart, tmp_path / "heart")
    read_only(copied)
    refused(["heart", "check", copied], copied, "choose another place (--picture)")
    picture = tmp_path / "a.png"
    assert run("heart", "check", copied, "--picture", picture).well
    assert picture.exists()


def test_completion(run):
    environment = os.environ | {
        "_FASCICLE_COMPLETE": "complete_bash", "COMP_WORDS": "fascicle sc", "COMP_CWORD": "1",
    }  # fmt: skip
    program = Path(sys.executable).with_name("fascicle")
    ended = subprocess.run([program], env=environment, capture_output=True, text=True)
    assert ended.stdout.split() == ["scenarios"]


class TestDocs:
    """`fascicle docs`: where messages lead somebody who has no checkout."""

    def test_shows_the_page_that_is_asked_for(self, run, refused):
        page = Path(__file__).parents[2] / "docs" / "files.md"
        for asked in ("files", "files.md", "docs/files.md"):
            assert run("docs", asked).out == page.read_text("utf-8")
        assert re.search(r"^files +Files and conventions$", run("docs").out, re.MULTILINE)
        refused(["docs", "file"], "there is no page 'file'", "files")

    def test_what_messages_name_is_installed(self):
        """As data-files of setuptools, which are found above the package."""
        repository = Path(__file__).parents[2]
        project = tomllib.loads((repository / "pyproject.toml").read_text("utf-8"))
        (pattern,) = project["tool"]["setuptools"]["data-files"]["share/doc/fascicle"]
        installed = {path.stem for path in repository.glob(pattern)}
        text = "".join(path.read_text("utf-8") for path in (repository / "src").rglob("*.py"))
        words = re.sub(r'"\s*\n\s*"|\s+', " ", text).replace("docs  ", "docs ")
        named = set(re.findall(r"fascicle docs ([a-z]+[a-z-]*)", words))
        assert len(named) >= 8
        assert named | set(re.findall(r"docs/([\w-]+)\.md", text)) <= installed

    def test_pages_beside_an_installed_package(self, monkeypatch, tmp_path):
        package = tmp_path / "lib" / "python3" / "site-packages" / "fascicle"
        shared = tmp_path / "share" / "doc" / "fascicle"
        for folder in (package, shared):
            folder.mkdir(parents=True)
        (shared / "api.md").touch()
        monkeypatch.setattr("fascicle.__file__", str(package / "__init__.py"))
        assert documentation() == {"api": shared / "api.md"}


@pytest.mark.parametrize(
    ("asked", "mine"),
    [
        *((f"{command} --out mine", "mine/ecg.csv") for command in (
            "simulate default", "fit default t.nc", "locate default t.nc", "predict study",
            "sweep study biventricular-pacing", "cohort table.csv", "demo", "heart build a.nii",
            "heart import --mesh a.vtu", "heart refine default", "heart add-electrodes default",
            "heart export default", "study export study",
        )),
        ("cohort table.csv --out mine", "mine/results.csv"),
        ("target rec.dat --out rec.dat", "rec.dat"),
        ("target rec.dat --out rec.nc", "rec.nc"),
        ("target rec.dat --out rec.nc", "rec.png"),
        ("report study --out page.html", "page.html"),
        ("template --out a.pdf", "a.pdf"),
        ("heart check default --picture a.svg", "a.svg"),
        ("heart export default --format vtu --out mesh.vtu", "mesh.vtu"),
        ("heart export default --format gmsh --out mesh.msh", "mesh.msh"),
        ("scenarios --log rec.dat", "rec.dat"),
    ],
)  # fmt: skip
def test_no_file_of_the_user_is_replaced(refused, tmp_path, monkeypatch, asked, mine):
    monkeypatch.chdir(tmp_path)
    Path(mine).parent.mkdir(exist_ok=True)
    Path(mine).write_text("mine")
    refused(asked.split(), Path(mine).name, "give a")
    assert [str(path) for path in Path().rglob("*.*")] == [mine]
    assert Path(mine).read_text() == "mine"
