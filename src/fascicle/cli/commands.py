"""The commands: read arguments, call the package, print."""

from __future__ import annotations

from pathlib import Path
from pydoc import pager
from typing import Annotated, Any

import typer
from typer import Argument, Option

import fascicle
from fascicle.cli import resumable
from fascicle.cli.hearts import heart_app
from fascicle.cli.options import (
    AgeOption,
    FixOption,
    FormatOption,
    FreeOption,
    HeartArgument,
    HeightOption,
    IndexOption,
    OutOption,
    SchedulerOption,
    SexOption,
    StudyArgument,
    WeightOption,
    WorkersOption,
    explicit,
    fit_options,
    fixed_values,
    free_file,
    free_folder,
    pool_at,
    wanted_parameters,
    with_scenario,
)
from fascicle.cli.output import Result, TerminalProgress, every_command, print_row, print_table
from fascicle.cli.recordings import target as target_command
from fascicle.cli.studies import cohort as cohort_command
from fascicle.cli.studies import study_app, written_summary
from fascicle.core.errors import InputError
from fascicle.core.ranges import did_you_mean, within

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Learn a patient's Purkinje network, with its uncertainty, from a heart model and an "
    "ordinary 12-lead ECG, and predict from it what pacing would do.\n\n"
    "The usual way: **heart build** from an anatomy, make a **target** of a recording, **fit**, "
    "then **predict** and **report**. **demo** does it all on a packaged heart.",
)
app.add_typer(heart_app, name="heart")
app.add_typer(study_app, name="study")


def _print_version(version: bool) -> None:
    if version:
        print(f"fascicle {fascicle.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """See the help of `app`; the version is printed before any command runs."""


@app.command()
@every_command
def simulate(
    heart: HeartArgument,
    out: OutOption = Path("simulation"),
    params: Annotated[
        Path | None, Option(help="TOML file of parameters, such as that of a network of a study.")
    ] = None,
    lv_tree: Annotated[Path | None, Option(help="LV Purkinje network: VTU/VTP lines.")] = None,
    rv_tree: Annotated[Path | None, Option(help="RV Purkinje network: VTU/VTP lines.")] = None,
    cv: Annotated[float | None, Option(help="Purkinje conduction velocity (m/s).")] = None,
    root_time: Annotated[
        float | None, Option(help="Delay between the roots, t_RV - t_LV (ms); negative: LV later.")
    ] = None,
    fix: FixOption = None,
    scenario: Annotated[
        str | None,
        Option(
            help="Name ('fascicle scenarios' lists them), or TOML file with stimuli, blocked or "
            "slow segments, junction delays, scar, additional trees ('fascicle docs files')."
        ),
    ] = None,
    action_potential: Annotated[
        Path | None,
        Option(
            metavar="TABLE",
            help="CSV table time_ms,potential_mV of the action potential, 0 ms at the upstroke, "
            "in place of the heart's or ten Tusscher and Panfilov's ('fascicle docs extending').",
        ),
    ] = None,
    kind: FormatOption = "png",
) -> Result:
    """Run the forward model: activation map, Purkinje networks, ECG, and what activated what.

    The networks are grown from parameters (an example if none are given; --cv, --root-time and
    --fix override them; 'fascicle parameters' lists them), or are two of your own. A scenario
    says what differs from the intrinsic beat:

    ```toml
    [[inactive_root]]              # a tree whose root does not fire
    tree = "lv"

    [[stimulus]]                   # pacing site in the myocardium (mm, ms)
    position = [73.4, -56.2, -39.1]
    time = 0.0

    [[slow_conduction]]
    tree = "rv"
    part = "bundle"                # or "fascicle 1", "fascicle 2", or a sphere
    speed = 0.0                    # factor on the speed; 0 blocks
    ```
    """
    from fascicle.cli.printing import print_simulation
    from fascicle.forward.preparation import compile_kernels
    from fascicle.forward.scenario_files import find_scenario, read_scenario
    from fascicle.forward.simulation_files import simulate_inputs, write_simulation
    from fascicle.reporting.prediction import draw_simulation

    overrides = fixed_values(fix, cv=cv, root_time=root_time)
    case, regions = read_scenario(find_scenario(scenario)) if scenario is not None else (None, ())
    table = action_potential
    template = fascicle.read_action_potential(table) if table is not None else None
    loaded = fascicle.load_heart(heart)
    with TerminalProgress() as progress:

        def make_model() -> fascicle.ForwardModel:
            compile_kernels(progress)
            conduction = fascicle.Conduction.of(loaded, regions)
            return fascicle.ForwardModel(
                loaded, conduction, action_potential=template, progress=progress
            )

        simulation, inputs, simulated = simulate_inputs(
            make_model, params, lv_tree, rv_tree, overrides, case
        )
    if scenario is not None:
        inputs["scenario"] = str(scenario)
    brought = loaded.action_potential is not None
    default = "heart.toml" if brought else "built-in (ten Tusscher-Panfilov)"
    inputs["action_potential"] = default if action_potential is None else str(action_potential)
    summary = write_simulation(simulated, simulation, out, inputs)
    zero = "firing of the first root" if case is None else "time 0 of the scenario"
    pictures = draw_simulation(simulated, simulation, out, kind, zero)
    print_simulation(simulation, summary)
    print(f"written to {out}: activation.vtu, *_tree.vtu, sites.csv, ecg.csv, summary.json")
    print(f"pictures: {', '.join(map(str, pictures))}")
    return {"folder": out, "pictures": pictures} | summary


app.command(name="target")(every_command(target_command))
app.command(name="cohort")(every_command(cohort_command))


@app.command()
@every_command
@fit_options
def fit(
    context: typer.Context,
    heart: HeartArgument,
    targets: Annotated[
        list[str],
        Argument(
            metavar="TARGET[:SCENARIO]...",
            help="Target made by 'fascicle target', with a scenario (of the library, or a TOML "
            "file) if the recorded beat was not intrinsic; or several targets of one heart.",
        ),
    ],
    out: Annotated[
        Path,
        Option("--out", help="Study folder; the same command resumes it.", callback=free_folder),
    ],
    settings_file: Annotated[
        Path | None, Option("--settings", help="TOML file of settings and parameters.")
    ] = None,
    free: FreeOption = None,
    fix: FixOption = None,
    scheduler: SchedulerOption = None,
    device: Annotated[
        str | None,
        Option(
            help="NVIDIA GPU to simulate on, with --method paper: cuda, cuda:1 the second "
            "('fascicle docs gpu')."
        ),
    ] = None,
    sex: SexOption = None,
    age: AgeOption = None,
    height: HeightOption = None,
    weight: WeightOption = None,
    **settings: Any,
) -> Result:
    """Learn the Purkinje networks that explain a target, and how well the ECG constrains them.

    Several recordings, such as of the intrinsic beat and paced from a known site
    ('fascicle fit HEART intrinsic.nc paced.nc:rv-apical-pacing --out STUDY'), must be explained by
    the same networks; the result says what the others add to the first. 'fascicle scenarios' lists
    the sites; a file of your own ends in .toml.

    The first line of the result begins with what is blocked: how probable it is that a bundle
    branch or a fascicle is, or that nothing is while a branch is delayed or the tissue is slow
    ('fascicle docs diagnosis'). '--fix conduction=normal' leaves that out, and is faster.

    For a person of whom there is no image, 'atlas' is the heart: hearts of the population, over
    which the result is averaged ('fascicle docs atlas'). It takes one recording of an intrinsic
    beat in all twelve leads, and learns the usual quantities alone.

    The first fit of a heart simulates networks of the prior and trains an emulator on them; both
    are kept with the heart. On the emulator the posterior is sampled in two independent runs. The
    first line says, too, whether they agree, and whether the networks that were simulated
    of it explain the recording.

    What is simulated is stored at once. The command may be interrupted at any time; run again, it
    continues where it stopped.

    A settings file can also name the quantities to learn and their priors ('fascicle parameters'
    lists them):

    ```toml
    effective = 500

    [parameters]
    cv = 2.5                                                      # fixed
    fibre_speed = { prior = "log-normal", median = 0.65, sd = 0.2 }
    interventricular_delay = { lower = 0.0, upper = 20.0 }        # uniform
    endocardial_speed = "free"
    endocardial_layer = 1.5
    ```
    """
    from fascicle.cli.printing import print_fit
    from fascicle.networks.prior import read_settings

    fit_settings = read_settings(settings_file) if settings_file is not None else {}
    learnt = fit_settings.pop("parameters", {}) | wanted_parameters(free, fix)
    fit_settings |= explicit(context, settings)
    with resumable(out), TerminalProgress() as progress:
        recordings: list[Any] = [with_scenario(target) for target in targets]
        if device is not None:
            fit_settings["backend"] = fascicle.GpuBackend(device)
        pool = pool_at(scheduler, progress)
        of_person = fascicle.load_heart(heart, sex=sex, age=age, height=height, weight=weight)
        fitted = fascicle.fit(
            of_person, recordings, out, parameters=learnt, progress=progress, pool=pool,
            **fit_settings,
        )  # fmt: skip
    summary = written_summary(out)
    print_fit(fitted, summary)
    print(f"study in {out}; figures: fascicle report {out}")
    return summary


@app.command()
@every_command
def locate(
    heart: HeartArgument,
    target: Annotated[Path, Argument(help="Target of the beat, made with 'target'.")],
    out: OutOption,
    prior_simulations: Annotated[
        int | None, Option(min=100, help="Beats to learn from; by default 16,000.")
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
) -> Result:
    """Say where an ectopic or paced beat comes from, with a probability of every place.

    Make the target of one class of beats: 'fascicle target FILE --class B --out ectopic.nc'. The
    answer is drawn on the heart (origin.png), and given for each tetrahedron (origin.vtu) and each
    of the 17 segments (origin.json).

    The first time, beats from all over the ventricles of a heart of your own are simulated, for ten
    minutes or more; they are stored in its folder and serve every recording. The command may be
    interrupted: run again, it continues where it stopped.
    """
    from fascicle.emulation.origin import ORIGIN_PICTURE
    from fascicle.reporting.activation import origin_figure
    from fascicle.reporting.style import save

    with TerminalProgress() as progress:
        origin = fascicle.locate(
            heart, target, prior_simulations=prior_simulations, workers=workers,
            progress=progress, pool=pool_at(scheduler, progress),
        )  # fmt: skip
        origin.save(out)
        save(origin_figure(origin), out / ORIGIN_PICTURE)
    print(origin.verdict)
    summary = origin.summary()
    print_row("region", f"{summary['region_ml']:.0f} ml of tissue hold the origin with 90 %")
    held_out = origin.held_out
    print_row(
        "held-out beats",
        f"median distance {held_out['distance']:.0f} mm; {held_out['region']:.0%} in such a region",
    )
    print(f"saved to {out}")
    return summary


@app.command()
@every_command
def states(
    heart: HeartArgument,
    target: Annotated[Path, Argument(help="Target of the intrinsic beat, made with 'target'.")],
    settings_file: Annotated[
        Path | None,
        Option("--settings", help="Settings file of a fit; its parameters are read, nothing else."),
    ] = None,
    prior_simulations: Annotated[
        int | None, Option(min=100, help="Networks to learn from; by default as many as for a fit.")
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    sex: SexOption = None,
    age: AgeOption = None,
    height: HeightOption = None,
    weight: WeightOption = None,
) -> Result:
    """Say how probable each conduction state is, without a fit, in seconds.

    States are a bundle branch block or delay, and slow conduction everywhere; their prior is how
    common they are in adults who are referred for an ECG. On the atlas probabilities are calibrated
    on people with cardiologists' labels, and fascicular blocks are named, too. No state is named
    where the recording is unlike all that are simulated on this heart, such as noise.

    A heart of your own is simulated once, which takes minutes; a packaged one has been. Parameters
    of a settings file, such as priors of another species, are simulated once for each heart.
    """
    from fascicle.networks.prior import read_settings

    file_settings = read_settings(settings_file) if settings_file is not None else {}
    with TerminalProgress() as progress:
        of_person = fascicle.load_heart(heart, sex=sex, age=age, height=height, weight=weight)
        probabilities = fascicle.state_probabilities(
            of_person, target, parameters=file_settings.get("parameters"),
            prior_simulations=prior_simulations, workers=workers, progress=progress,
            pool=pool_at(scheduler, progress),
        )  # fmt: skip
    if of_person.no_image:
        print(of_person.no_image)
    if isinstance(probabilities, fascicle.NoStateNamed):
        print(probabilities)
        return {
            "states": None,
            "reason": probabilities.reason,
            "unreliable": dict(probabilities.unreliable),
        }
    ranked = sorted(probabilities, key=lambda name: -probabilities[name])
    print_table([(name, f"{probabilities[name]:.2f}") for name in ranked])
    basis = "as simulated on this heart, not calibrated on people ('fascicle docs diagnosis')"
    if of_person.no_image:
        basis = "calibrated on cardiologists' labels of 245 people ('fascicle docs atlas')"
    print(basis)
    return {"states": dict(probabilities), "reason": None}


@app.command()
@every_command
def explore(
    heart: Annotated[
        str, Argument(metavar="HEART|STUDY", help="Heart folder, study, or a packaged heart.")
    ] = "camps-dti004",
    target: Annotated[
        Path | None, Option(help="Target that simulated ECGs are compared with.")
    ] = None,
    port: Annotated[
        int, Option(min=0, max=65535, help="Port of the local page; by default any free one.")
    ] = 0,
    browser: Annotated[
        bool, Option(help="Open the page; else only its address is printed.")
    ] = True,
) -> Result:
    """Explore a heart: networks, activation and ECG follow every parameter as it is moved.

    A local page opens in the browser. Click the heart to pace there, or a branch to block it; fire
    the His bundle or the left bundle; step through the networks of a study; pin a beat and compare;
    save parameters and scenario for 'fascicle simulate', a picture or a film. It ends with the last
    page, or Ctrl-C. Only this machine can open the page, and nothing is loaded from elsewhere.
    """
    from fascicle.explorer.explore import listen, serve, session_of

    with listen(port) as listening:
        with TerminalProgress() as progress:
            session = session_of(heart, target, progress)
        serve(session, listening, browser=browser)
    return {}


@app.command()
@every_command
def predict(
    study: StudyArgument,
    out: OutOption,
    scenario: Annotated[
        list[str] | None,
        Option(
            help="Name ('fascicle scenarios' lists them) or TOML file of a scenario; may be "
            "given several times. Default: his-pacing, in which both roots fire together."
        ),
    ] = None,
    kind: FormatOption = "png",
    scheduler: SchedulerOption = None,
) -> Result:
    """Predict pacing, blocks and ectopic beats with every network of the population.

    Each is compared with the intrinsic beat: QRS duration, activation times, dyssynchrony, QRS area
    and more ('fascicle docs predictions'), twelve-lead ECGs as the recorder would show them, and
    activation maps. Intervals are over the networks: they show what the ECG does not determine.
    """
    from fascicle.cli.printing import print_prediction, print_verdict
    from fascicle.prediction.scenarios import prior_networks, simulate_scenarios
    from fascicle.reporting.prediction import write_prediction
    from fascicle.study.population import Posterior

    scenarios, prior = fascicle.read_scenarios(scenario or ["his-pacing"]), None
    with TerminalProgress() as progress:
        fitted = fascicle.load_study(study, progress, pool_at(scheduler, progress))
        predicted = fascicle.predict(fitted, scenarios, progress)
        write_prediction(fitted, predicted, out, kind, progress)
        if isinstance(fitted.population, Posterior) and fitted.population.converged:
            networks = prior_networks(fitted, progress)
            prior = simulate_scenarios(
                fitted.simulator, fitted.recordings[0], networks, scenarios, progress, " (prior)"
            )
    print_verdict(fitted)
    print_prediction(predicted, prior)
    print(f"prediction in {out}")
    return written_summary(out)


@app.command()
@every_command
def compare(
    study: StudyArgument,
    first: Annotated[str, Argument(help="Scenario, by name or file.")],
    second: Annotated[str, Argument(help="Scenario to compare it with.")],
    index: IndexOption = "total_activation_time",
    threshold: Annotated[
        float, Option(help="Least reduction that matters, in the unit of the index.")
    ] = 0.0,
    scheduler: SchedulerOption = None,
) -> Result:
    """Print the probability that one scenario is better than another, by how much, and why.

    They are compared in each network of the population; 'intrinsic' is the intrinsic beat. All
    indices are shown, since they may disagree. Pacing at the right apex is simulated as well: the
    last lines say how much a measurement of that beat, or of the intrinsic one, would tell.
    """
    from fascicle.cli.printing import comparison_result, print_comparison, print_verdict
    from fascicle.prediction.index_names import check_index

    check_index(index)
    within("threshold", threshold, "--threshold")
    pair = fascicle.read_scenarios([first, second])
    with TerminalProgress() as progress:
        fitted = fascicle.load_study(study, progress, pool_at(scheduler, progress))
        predicted = fascicle.predict(
            fitted, fascicle.read_scenarios(["rv-apical-pacing"]) | pair, progress
        )
    print_verdict(fitted)
    comparison = comparison_result(
        list(pair), predicted, index, threshold, fitted.population.values
    )
    print_comparison(predicted, comparison)
    return {"verdict": fitted.verdict, "caution": fitted.statements.caution_text} | comparison


@app.command()
@every_command
def sweep(
    study: StudyArgument,
    scenario: Annotated[str, Argument(help="Scenario to vary, by name or file.")],
    out: OutOption,
    delay: Annotated[
        str | None,
        Option(help="Delays of the last stimulus after the first: first:last:step (ms)."),
    ] = None,
    layer: Annotated[
        str | None,
        Option(
            "--segments",
            help="Move the last myocardial stimulus over all 17 segments of the left ventricle, "
            "under this layer: endocardium or epicardium.",
        ),
    ] = None,
    radius: Annotated[
        str | None, Option(help="Capture radii of the myocardial stimuli: first:last:step (mm).")
    ] = None,
    index: IndexOption = "total_activation_time",
    networks: Annotated[int, Option(min=2, help="Networks of the population to use.")] = 60,
    scheduler: SchedulerOption = None,
) -> Result:
    """Vary a delay, a site or a capture radius in networks of the population.

    Biventricular pacing with the left side up to 60 ms before and after the right one:

        fascicle sweep STUDY biventricular-pacing --delay=-60:60:10 --out SWEEP
    """
    from fascicle.cli.printing import print_sweep, print_verdict
    from fascicle.prediction.comparison import delays, radii, segments, simulate_sweep
    from fascicle.prediction.index_names import check_index
    from fascicle.reporting.prediction import write_sweep

    check_index(index)
    ((name, case),) = fascicle.read_scenarios([scenario]).items()
    ways = {delays: delay, segments: layer, radii: radius}
    chosen = [(vary, how) for vary, how in ways.items() if how is not None]
    if len(chosen) != 1:
        raise InputError("give one of --delay, --segments and --radius, which say what to vary")
    ((vary, how),) = chosen
    family = vary(case, how)
    with TerminalProgress() as progress:
        fitted = fascicle.load_study(study, progress, pool_at(scheduler, progress))
        swept = simulate_sweep(fitted, family, networks, progress)
        write_sweep(fitted, swept, name, index, out)
    print_verdict(fitted)
    print_sweep(swept, index)
    print(f"sweep in {out}")
    return written_summary(out)


@app.command()
@every_command
def scenarios(
    name: Annotated[
        str | None, Argument(help="Print the file of this scenario, to copy and change.")
    ] = None,
) -> Result:
    """List the scenarios that come with fascicle, for `predict` and `simulate`."""
    from fascicle.core.files import check_file
    from fascicle.forward.scenario_files import find_scenario, library, read_scenario

    if name is not None:
        path = find_scenario(name)
        check_file(path, (".toml",), "scenario")
        text = path.read_text(encoding="utf-8")
        print(text, end="")
        return {"name": name, "file": text}
    descriptions = {name: read_scenario(path)[0].description for name, path in library().items()}
    print_table([*descriptions.items()])
    return descriptions


@app.command()
@every_command
def docs(
    page: Annotated[str | None, Argument(help="Show this page, such as hearts or files.")] = None,
) -> Result:
    """List the pages of the documentation, or show one."""
    pages = documentation()
    if page is None:
        titles = {name: path.open(encoding="utf-8").readline() for name, path in pages.items()}
        print_table([(name, title.strip("# \n")) for name, title in titles.items()])
        return pages
    name = page.removeprefix("docs/").removesuffix(".md")
    if name not in pages:
        known = f"there are {', '.join(pages)}"
        raise InputError(f"there is no page '{page}'; {did_you_mean(name, pages) or known}")
    text = pages[name].read_text(encoding="utf-8")
    pager(text)
    return {"page": name, "text": text}


def documentation() -> dict[str, Path]:
    """Pages of the documentation by their names: of the checkout, or as they were installed."""
    above = Path(fascicle.__file__).parents
    installed = (folder / "share/doc/fascicle" for folder in above)  # data-files in pyproject.toml
    folders = [f for f in (above[2] / "docs", *installed) if (f / "api.md").exists()]
    return {path.stem: path for folder in folders[:1] for path in sorted(folder.glob("*.md"))}


@app.command()
@every_command
def parameters() -> Result:
    """List every quantity of the model: unit, default, range of its prior, meaning.

    Any of them can be fixed in `simulate` and `fit` (--fix NAME=VALUE), and all but counts can be
    learnt (--free NAME). The values of a heart are in its heart.toml.
    """
    from fascicle.core.parameters import HUMAN_SPACE
    from fascicle.core.quantities import GROUPS, QUANTITIES, quantity

    rows = [("name", "unit", "default", "prior range", "meaning")]
    for parameter in (*QUANTITIES.values(), quantity("region_1_conductivity")):
        # the other fascicles are as the first
        if "_fascicle_" not in parameter.name or parameter.name.endswith("_1"):
            default = "" if parameter.default is None else f"{parameter.default:g}"
            prior = (
                "" if parameter.is_integer else "{:.3g} to {:.3g}".format(*parameter.prior_range)
            )
            rows.append((parameter.name, parameter.unit, default, prior, parameter.meaning))
    print_table(rows)
    print("By default a fit learns, with priors of human anatomy:")
    print_table([(p.name, p.unit, f"{p.lower:g} to {p.upper:g}") for p in HUMAN_SPACE.parameters])
    print("Groups that can be freed together (--free NAME): " + ", ".join(GROUPS))
    print("Fascicles are numbered 1 to at most 4; regions by their labels.")
    for parameter in QUANTITIES.values():
        if parameter.choices:
            print(f"{parameter.name}: {', '.join(parameter.choices)}")
    shown = ("name", "unit", "default", "prior_range", "meaning", "choices")
    return [
        {key: getattr(parameter, key) for key in shown}
        | ({"prior_range": None} if parameter.is_integer else {})
        for parameter in QUANTITIES.values()
    ]


@app.command()
@every_command
def report(
    study: StudyArgument,
    scenario: Annotated[
        list[str] | None,
        Option(
            help="Name ('fascicle scenarios' lists them) or TOML file of a scenario; may be "
            "given several times. Default: three kinds of pacing."
        ),
    ] = None,
    against: Annotated[
        str, Option(help="Scenario that all are compared with, such as a block.")
    ] = "intrinsic",
    out: Annotated[
        Path | None,
        Option("--out", help="HTML file; by default report.html in the study.", callback=free_file),
    ] = None,
    figures: Annotated[
        list[str] | None,
        Option(
            "--format",
            help="Also write the figures into the folder figures next to it, as png, svg or pdf; "
            "may be given several times.",
        ),
    ] = None,
    pdf: Annotated[
        bool, Option("--pdf", help="Also write the answer on one page next to it, as PDF.")
    ] = False,
    scheduler: SchedulerOption = None,
) -> Result:
    """Write the results of a study as one HTML file that opens offline.

    First the answer in words; then the recorded and the simulated ECG, a heart in 3-D with the
    activation of every scenario, the scenarios compared, parameters, convergence, inputs.
    """
    from fascicle.reporting.page.page import PACINGS

    kinds, scenarios = figures or [], fascicle.read_scenarios(scenario or PACINGS)
    with TerminalProgress() as progress:
        fitted = fascicle.load_study(study, progress, pool_at(scheduler, progress))
        page, *drawn = fascicle.report(fitted, scenarios, out, progress, kinds, against, pdf)
    print_row("result", fitted.verdict)
    for path in (*drawn, page.resolve().as_uri()):
        print(path)
    return {"verdict": fitted.verdict, "page": page, "figures": drawn}


@app.command()
@every_command
def template(
    out: Annotated[
        Path, Option("--out", help="Picture to write (PNG, PDF, SVG).", callback=free_file)
    ] = Path("template.png"),
) -> Result:
    """Draw the action potentials that ECGs are computed from, and print their measures.

    They are those of ten Tusscher and Panfilov's cell (2006) in the middle of a cable.
    """
    from fascicle.reporting.ecg import template_figure
    from fascicle.reporting.style import check_picture, save

    check_picture(out)
    with TerminalProgress() as progress:
        figure, measures = template_figure(progress)
    save(figure, out)
    columns = {
        "resting_potential": "rest (mV)",
        "overshoot": "overshoot (mV)",
        "max_upstroke": "dV/dt max (V/s)",
        "apd90": "APD90 (ms)",
        "conduction_velocity": "speed (m/s)",
    }
    rows = [
        (cell, *(f"{measured[key]:.4g}" for key in columns)) for cell, measured in measures.items()
    ]
    print_table([("", *columns.values()), *rows])
    print(f"picture: {out}")
    return {"picture": out, "measures": measures}


@app.command()
@every_command
def demo(out: OutOption = Path("fascicle-demo")) -> Result:
    """Fit a subject's own ECG on that subject's heart, then diagnose a block and pace it.

    The heart and the ECG are those of one living subject (Camps et al. 2024). The block is a left
    bundle branch block simulated on the same heart, so that the truth is known: by how much each
    pacing shortens activation is printed with what is found. It takes two minutes.
    """
    from fascicle.cli.demo import fit_own_beat, treat_block
    from fascicle.cli.printing import print_fit, print_prediction, print_reductions

    heart, block, own_beat = "camps-dti004", "left bundle branch block", out / "own-beat"
    with resumable(own_beat), TerminalProgress() as progress:
        fitted = fit_own_beat(heart, own_beat, progress)
    print_row("own beat", fitted.verdict)
    for warning in fitted.warnings:
        print(f"warning: {warning}")
    with resumable(out), TerminalProgress() as progress:
        fitted, predicted, reductions = treat_block(heart, block, out, progress)
    print(f"\n{block}, simulated on the same heart")
    print_fit(fitted, written_summary(out / "study"))
    print_prediction(predicted)
    print_reductions(predicted, "intrinsic")
    print("in truth " + ", ".join(f"{name} by {time:.0f} ms" for name, time in reductions.items()))
    page = out / "report.html"
    print(f"\nin {out}: the recordings (target.png), the studies, the pacings as tables")
    print(f"to explore the networks: fascicle explore {out / 'study'}")
    print(f"to read in a browser: {page.resolve().as_uri()}")
    folders = {"own_beat": own_beat / "study", "study": out / "study", "pacings": out / "pacings"}
    parts = {part: written_summary(folder) for part, folder in folders.items()}
    return {"folder": out, "page": page, "true_reductions_ms": reductions} | parts
