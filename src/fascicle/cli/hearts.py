"""`fascicle heart …`: build, import, check, refine and export heart folders."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer import Argument, Option

import fascicle
from fascicle.cli.options import (
    Command,
    HeartArgument,
    OutOption,
    SchedulerOption,
    WorkersOption,
    free_file,
    lead_names,
    option,
    pool_at,
    with_options,
)
from fascicle.cli.output import Result, TerminalProgress, every_command, print_table
from fascicle.core.errors import InputError, given_in
from fascicle.core.quantities import SIDES

if TYPE_CHECKING:
    from fascicle.build.build_heart import TorsoOptions
    from fascicle.heart.endocardium import ChosenSeed
    from fascicle.heart.fibres import FibreAngles
    from fascicle.heart.heart import Heart
    from fascicle.purkinje.chart import Chart


# Options in the panels of ``--help``
_anatomy = partial(Option, rich_help_panel="Anatomy")
_fibres = partial(Option, rich_help_panel="Fibres")

AnatomyArgument = Annotated[
    Path | None,
    Argument(
        help="Closed surface (VTP, VTK, STL, OBJ, PLY), segmentation (NIfTI, NRRD) or "
        "tetrahedra or hexahedra (VTU, VTK, Gmsh, openCARP .pts)."
    ),
]
PartOption = Annotated[
    Path | None,
    _anatomy(help="One of separate surfaces, which need not meet exactly; a missing base is made."),
]
RegionsOption = Annotated[
    str | None,
    _anatomy(
        help="Numbers of the ventricles in a mesh of a whole heart, as lv=1,rv=2,septum=7; a name "
        "may come several times."
    ),
]
RegionArrayOption = Annotated[
    str | None, _anatomy(help="Name of the file's array that holds the regions.")
]

heart_app = typer.Typer(
    no_args_is_help=True,
    help="Build heart folders from an anatomy or a finished mesh; check, refine and export them.",
)


def _with_torso_and_bundles(torso: str) -> Callable[[Command], Command]:
    """Give a command the options of the torso, which is `torso` by default, and of the bundles."""
    around, lung = partial(option, panel="Torso"), "Closed surface of a lung, with --torso FILE."
    places = {
        "root": "Where the bundle reaches the endocardium; by default in the middle of the septum, "
        "8 to 22 % of the way from base to apex.",
        "direction": "Point that the bundle heads for; by default halfway to the apex.",
    }
    point = "Number of the point, from 0, or x,y,z in mm, within 5 mm of one."
    skin = "'idealised', 'none' (unbounded conductor), or a closed surface of the skin."
    pose = (
        "How the heart lies in the idealised torso: 'standard' by its electrodes, or without them "
        "by its axes; 'ras' (NIfTI) or 'lps' (DICOM) where its coordinates are the patient's."
    )
    options = [
        around("torso", str, torso, help=skin),
        around("lung", list[Path] | None, None, help=lung),
        around("height", float | None, None, help="Height of the person (cm)."),
        around("weight", float | None, None, help="Weight of the person (kg)."),
        around("chest", float | None, None, help="Circumference of the chest (cm)."),
        around("pose", Literal["standard", "ras", "lps"], "standard", help=pose),
        *(
            option(f"{side}_{end}", str | None, None, panel="Bundles", help=f"{help_text} {point}")
            for side in SIDES
            for end, help_text in places.items()
        ),
    ]
    return lambda command: with_options(command, options)


@heart_app.command("build")
@every_command
@_with_torso_and_bundles("idealised")
def heart_build(
    anatomy: AnatomyArgument = None,
    out: Annotated[
        Path | None, Option("--out", help="Folder to write; by default named after the file.")
    ] = None,
    edge_length: Annotated[float, Option(help="Mean edge of the mesh (mm).")] = 2.0,
    labels: Annotated[
        str | None,
        _anatomy(
            help="Numbers in the file, as base=1,epicardium=2,lv=3,rv=4 (surfaces) or "
            "lv=1,rv=2,myocardium=3,scar=4 (segmentations)."
        ),
    ] = None,
    label_array: Annotated[
        str | None,
        _anatomy(
            help="Name of the file's array that holds them; by default 'label', 'class', "
            "'surface' or 'boundary'."
        ),
    ] = None,
    regions: RegionsOption = None,
    region_array: RegionArrayOption = None,
    remesh: Annotated[
        bool,
        _anatomy(
            help="Remesh the inside of a tetrahedral mesh that has flat elements; its surface, "
            "fibres and regions stay."
        ),
    ] = False,
    lv_endocardium: PartOption = None,
    rv_endocardium: PartOption = None,
    epicardium: PartOption = None,
    base: PartOption = None,
    fibres: Annotated[
        Literal["rule", "file"] | None,
        _fibres(
            help="Those of a rule or of the mesh's file; by default the file's, unless they are a "
            "placeholder."
        ),
    ] = None,
    lv_angles: Annotated[
        str, _fibres(help="Helix angles of the LV, endocardium,epicardium (degrees).")
    ] = "60,-60",
    rv_angles: Annotated[
        str, _fibres(help="Helix angles of the RV, endocardium,epicardium (degrees).")
    ] = "90,-25",
    electrodes: Annotated[
        Path | None,
        Option(
            rich_help_panel="Torso",
            help="Nine electrodes, CSV name,x,y,z or JSON, to which the idealised torso is fitted; "
            "by default they are at its standard positions.",
        ),
    ] = None,
    **around: Any,
) -> Result:
    """Build a heart folder from an anatomy: mesh, fibres, bundles, torso, electrodes, lead fields.

    One closed surface, with or without labels; separate surfaces; a segmentation; or a mesh of
    your own. The result is printed and drawn (check.png in the folder): look at it.

    ```
    fascicle heart build heart.vtp
    fascicle heart build labels.nii.gz --labels lv=1,rv=2,myocardium=3 --pose ras
    fascicle heart build whole_heart.vtu --regions lv=1,rv=2,septum=7
    fascicle heart build --lv-endocardium lv.stl --rv-endocardium rv.stl --epicardium epi.stl
    ```
    """
    from fascicle.build.build_heart import build_heart
    from fascicle.build.read_anatomy import Source
    from fascicle.heart.folder import HEART_FILES, check_heart_folder
    from fascicle.reporting.heart import labels_figure
    from fascicle.reporting.style import save

    numbers = _numbers("--labels", labels) or {}
    if any(len(values) > 1 for values in numbers.values()):
        raise InputError(f"--labels {labels}: give every name once, such as lv=3,rv=4")
    parts = {"lv": lv_endocardium, "rv": rv_endocardium, "epicardium": epicardium, "base": base}
    source = Source(
        file=anatomy,
        parts={part: path for part, path in parts.items() if path is not None},
        labels={name: values[0] for name, values in numbers.items()} if numbers else None,
        label_array=label_array,
        remesh=remesh or None,
        regions=_numbers("--regions", regions),
        region_array=region_array,
        fibres=fibres,
    )
    angles = _fibre_angles(lv_angles, rv_angles)
    seeds, torso = _seeds(around), _torso(around, electrodes)
    folder = out if out is not None else Path(source.name)
    files = (anatomy, *parts.values(), electrodes, Path(around["torso"]), *torso.lungs)
    check_heart_folder(folder, [path for path in files if path is not None and path.is_file()])
    with TerminalProgress() as progress:
        built = build_heart(
            source,
            edge_length=edge_length,
            angles=angles,
            torso=torso,
            seeds=seeds,
            name=folder.resolve().name,
            progress=progress,
        )
    contents = _write_and_check(built.heart, folder, built.notes, warnings=built.anatomy.warnings)
    if built.anatomy.guessed:
        save(labels_figure(built.anatomy.mesh), picture := folder / HEART_FILES["labels"])
        print(
            f"labels were found, not given: look at {picture}; if they are wrong, label the "
            "surface in the file"
        )
    return contents


@heart_app.command("import")
@every_command
@_with_torso_and_bundles("none")
def heart_import(
    mesh: Annotated[Path, Option(help="Tetrahedral mesh in mm (VTK, VTU, Gmsh).")],
    fibres: Annotated[
        str,
        Option(
            help="File of fibres, one vector per point or tetrahedron; 'file', those in the mesh's "
            "file, whatever they are; or 'rule'."
        ),
    ],
    lv_endocardium: Annotated[Path, Option(help="LV endocardium, open at the base.")],
    rv_endocardium: Annotated[Path, Option(help="RV endocardium, open at the base.")],
    electrodes: Annotated[Path, Option(help="Nine electrodes: CSV name,x,y,z or JSON.")],
    out: OutOption,
    regions: RegionsOption = None,
    region_array: RegionArrayOption = None,
    **around: Any,
) -> Result:
    """Make a heart folder from finished parts: mesh, fibres, endocardia, electrodes.

    Surfaces may be VTK, VTP, OBJ, STL, PLY or Gmsh. Fibres are matched by position, so their
    points may come in another order; a rule takes the place of a placeholder, such as one direction
    everywhere. Without **--torso idealised** the volume conductor is unbounded, and the ratios of
    the leads are wrong.
    """
    from fascicle.build.build_heart import in_torso
    from fascicle.build.surface_checks import check_sides
    from fascicle.build.whole_heart import ventricles
    from fascicle.core.progress import stage_progress
    from fascicle.heart.assembly import assemble_heart
    from fascicle.heart.coordinates import with_coordinates
    from fascicle.heart.folder import check_heart_folder
    from fascicle.heart.labelled_surface import labelled_mesh, missing_parts
    from fascicle.mesh.read import read_mesh

    inputs = [mesh, Path(fibres), lv_endocardium, rv_endocardium, electrodes]
    check_heart_folder(out, [path for path in inputs if path.is_file()])
    torso = _torso(around, electrodes)
    tissue = read_mesh(mesh, "mesh")
    if (numbers := _numbers("--regions", regions)) is not None:
        tissue, _ = ventricles(tissue, numbers, region_array)
    from_file = fibres not in ("file", "rule")
    about_fibres: list[str] = []
    heart = assemble_heart(
        mesh=tissue,
        fibres=read_mesh(fibres, "fibres") if from_file else None,
        surfaces={
            "lv": read_mesh(lv_endocardium, "LV endocardium"),
            "rv": read_mesh(rv_endocardium, "RV endocardium"),
        },
        seeds=_seeds(around),
        electrodes=electrodes,
        name=out.resolve().name,
        by_rule=None if from_file else fibres == "rule",
        notes=about_fibres,
    )
    with TerminalProgress() as progress:
        labelled = labelled_mesh(heart)
        if not missing_parts(labelled.labels):
            check_sides(replace(labelled, name=f"{lv_endocardium}, {rv_endocardium}"))
        heart, located = with_coordinates(heart, labelled, stage_progress(progress, "coordinates"))
        heart, notes = in_torso(heart, labelled, torso, progress)
    notes = (*about_fibres, *located, *notes)
    return _write_and_check(heart, out, notes, {"lv": lv_endocardium, "rv": rv_endocardium})


@heart_app.command("check")
@every_command
def heart_check(
    heart: HeartArgument,
    picture: Annotated[
        Path | None,
        Option(
            help="Picture to write (PNG, PDF, SVG); by default check.png in the folder.",
            callback=free_file,
        ),
    ] = None,
) -> Result:
    """Validate a heart folder; print and draw what it holds, with warnings and their remedies.

    Points are numbers of an endocardium's vertices, as --lv-root and --lv-direction of 'heart
    build' take them. 'fascicle docs hearts' explains the lines.
    """
    from fascicle.core.files import check_writable
    from fascicle.heart.folder import HEART_FILES
    from fascicle.reporting.style import check_picture

    if picture is not None:
        check_picture(picture)
    loaded = fascicle.load_heart(heart)
    if picture is None and Path(heart).is_dir():  # not for the packaged heart
        picture = Path(heart) / HEART_FILES["check"]
        check_writable(picture, "--picture")
    return _check(loaded, _growable_charts(loaded, {"lv": heart, "rv": heart}), picture)


@heart_app.command("refine")
@every_command
def heart_refine(heart: HeartArgument, out: OutOption) -> Result:
    """Cut every tetrahedron of a heart into eight.

    The error of activation times, and so of the ECG, halves with the edge length
    ('fascicle docs error-budget'). Fibres, regions and lead fields are those of the coarser mesh;
    endocardia, electrodes and bundles stay. The torso is left out: the mesh holds the lead fields.
    """
    from fascicle.build.refinement import refined
    from fascicle.heart.folder import HEART_FILES, check_heart_folder

    check_heart_folder(out, [Path(heart) / HEART_FILES["manifest"]])
    coarse = fascicle.load_heart(heart)
    with TerminalProgress() as progress:
        finer = refined(coarse, progress)
    contents = _write_and_check(finer, out)
    sizes = ("tetrahedra", *(f"{len(mesh.tetrahedra)}" for mesh in (coarse, finer)))
    edges = ("mean edge, mm", *(f"{mesh.edge_length:.2f}" for mesh in (coarse, finer)))
    print_table([("", "before", "after"), sizes, edges])
    return contents


@heart_app.command("add-electrodes")
@every_command
def heart_add_electrodes(
    heart: HeartArgument,
    out: OutOption,
    leads: Annotated[
        str, Option(help="Leads besides the twelve: X, Y, Z (Frank), V7 to V9, V2R to V6R.")
    ] = "V7-V9,V3R-V4R,X-Z",
) -> Result:
    """Add electrodes besides the nine to a heart in a torso, at their standard places.

    Simulations then give the leads of these electrodes, too, and fits compare those that were
    recorded. The packaged heart is put into its idealised torso. Electrodes of your own, such as a
    vest's, are more lines of the folder's electrodes.csv: each makes a unipolar lead of its name.

    ```
    fascicle heart add-electrodes default --leads X-Z --out heart-frank
    fascicle simulate heart-frank
    ```
    """
    from fascicle.build.build_heart import add_electrodes
    from fascicle.heart.folder import HEART_FILES, check_heart_folder

    check_heart_folder(out, [Path(heart) / HEART_FILES["manifest"]])
    with TerminalProgress() as progress:
        more = add_electrodes(heart, lead_names(leads), progress)
    return _write_and_check(more, out)


@heart_app.command("simulate-prior")
@every_command
def heart_simulate_prior(
    heart: HeartArgument,
    networks: Annotated[
        int | None,
        Option("--networks", min=1, help="Number of networks; by default that of a fit."),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
) -> Result:
    """Simulate networks of the prior once, and train the emulators that every fit samples.

    Those of every conduction state, with the classifier that tells them apart. All are stored in
    the heart's folder and serve every recording, if the fit learns default parameters, or others
    that the simulations vary, within their ranges ('fascicle docs posterior'); a fit makes them if
    they are missing. The command may be interrupted at any time: run again, it continues where it
    stopped; a larger number adds to what is stored.
    """
    with TerminalProgress() as progress:
        pool = pool_at(scheduler, progress)
        folder = fascicle.simulate_prior(
            heart, networks, workers=workers, progress=progress, pool=pool
        )
    print(f"prior simulations in {folder}")
    return {"prior_simulations": folder}


@heart_app.command("export")
@every_command
def heart_export(
    heart: HeartArgument,
    out: Annotated[Path, Option("--out", help="Folder to write; of Gmsh and VTU the file.")],
    kind: Annotated[
        Literal["opencarp", "gmsh", "vtu"],
        Option("--format", help="openCARP in µm, Gmsh and VTU in mm."),
    ] = "opencarp",
) -> Result:
    """Write a heart for other software: mesh, fibres, sheets, regions, endocardia, electrodes."""
    from fascicle.build.export import export_heart

    export_heart(fascicle.load_heart(heart), out, kind)
    print(f"written to {out}")
    return {"folder": out, "format": kind}


def _write_and_check(
    heart: Heart,
    folder: Path,
    notes: Sequence[str] = (),
    sources: Mapping[str, object] | None = None,
    warnings: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Write a heart folder and its picture, and print the notes and the contents."""
    from fascicle.heart.folder import HEART_FILES, write_heart

    for note in notes:
        print(note)
    charts = _growable_charts(heart, sources if sources is not None else {})
    write_heart(heart, folder)
    contents = _check(heart, charts, folder / HEART_FILES["check"], warnings)
    print(f"heart written to {folder}")
    return {"folder": folder, "notes": notes} | contents


def _check(
    heart: Heart, charts: Mapping[str, Chart], picture: Path | None, warnings: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Print and draw the contents of a heart; the warnings of its source come first."""
    from fascicle.build.check import check_heart
    from fascicle.reporting.heart import check_figure
    from fascicle.reporting.style import save

    contents = check_heart(heart, charts)
    print(heart.name)
    for label, value in contents.rows:
        print(f"  {label:<18} {value}")
    warnings = (*warnings, *contents.warnings)
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if picture is not None:
        save(check_figure(heart, contents), picture)
        print(f"picture: {picture}")
    count = len(warnings)
    print(f"{count} warning{'s' * (count > 1)}" if count else "no problem found")
    rows = dict(contents.rows)
    return {"heart": heart.name, "found": rows, "warnings": warnings, "picture": picture}


def _growable_charts(heart: Heart, sources: Mapping[str, object]) -> dict[str, Chart]:
    """Build charts and seeds, which refuse an endocardium on which no tree can grow."""
    from fascicle.purkinje.chart import build_chart
    from fascicle.purkinje.growth import find_seed

    charts = {}
    for endocardium in heart.endocardia:
        with given_in(sources.get(endocardium.side, heart.name)):
            charts[endocardium.side] = build_chart(endocardium)
            find_seed(endocardium, charts[endocardium.side])
    return charts


def _numbers(option: str, text: str | None) -> dict[str, tuple[int, ...]] | None:
    """Read 'lv=1,lv=8,rv=2' as names and the numbers of each."""
    if text is None:
        return None
    numbers: dict[str, tuple[int, ...]] = {}
    for item in text.split(","):
        name, _, number = (part.strip().lower() for part in item.partition("="))
        if not re.fullmatch(r"-?\d+", number):
            raise InputError(f"{option} {text}: give names with a number each, such as lv=3,rv=4")
        numbers[name] = (*numbers.get(name, ()), int(number))
    return numbers


def _fibre_angles(lv: str, rv: str) -> FibreAngles:
    """Read helix angles as '60,-60' (degrees), endocardium and epicardium."""
    from fascicle.heart.fibres import FibreAngles

    angles: list[float] = []
    for name, text in (("--lv-angles", lv), ("--rv-angles", rv)):
        values = _floats(text, 2)
        if values is None or max(map(abs, values)) > 90:
            needed = "two angles between -90 and 90 degrees, endocardium,epicardium"
            raise InputError(f"{name} {text}: give {needed}")
        angles += map(math.radians, values)
    return FibreAngles(*angles)


def _torso(options: Mapping[str, Any], electrodes: Path | None) -> TorsoOptions:
    from fascicle.build.build_heart import TorsoOptions

    measures = {name: options[name] for name in ("height", "weight", "chest")}
    stated = {name: value for name, value in measures.items() if value is not None}
    if "height" in stated:
        stated["height"] /= 100  # m
    lungs = tuple(options["lung"] or ())
    return TorsoOptions(options["torso"], lungs, stated, options["pose"], electrodes)


def _seeds(options: Mapping[str, Any]) -> dict[str, tuple[ChosenSeed, ChosenSeed]]:
    """Read root and direction of both bundles: numbers of points, or three coordinates (mm)."""

    def seed(side: str, end: str) -> ChosenSeed:
        text = options[f"{side}_{end}"]
        if text is None or re.fullmatch(r"\s*-?\d+\s*", text):
            return text if text is None else int(text)
        values = _floats(text, 3)
        if values is None:
            raise InputError(
                f"--{side}-{end} {text}: give the number of a point of the endocardium, "
                "from 0, or its position x,y,z (mm)"
            )
        return values[0], values[1], values[2]

    return {side: (seed(side, "root"), seed(side, "direction")) for side in SIDES}


def _floats(text: str, count: int) -> list[float] | None:
    """`count` finite numbers between commas, else None."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        return None
    return values if len(values) == count and all(map(math.isfinite, values)) else None
