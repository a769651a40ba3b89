"""`fascicle heart …`: build, import, check and export heart folders."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from fascicle.cli.arguments import HeartArgument, OutOption
from fascicle.core.errors import InputError

if TYPE_CHECKING:
    from fascicle.heart.heart import Heart
    from fascicle.heart.labelled_surface import LabelledMesh
    from fascicle.heart.seeds import ChosenSeed
    from fascicle.purkinje.chart import Chart

heart_app = typer.Typer(
    no_args_is_help=True,
    help="Build heart folders from an anatomy or a finished mesh; check and export them.",
)

ANATOMY, FIBRES, BODY, SEEDS = "Anatomy", "Fibres", "Torso and electrodes", "Bundles"
SeedOption = Annotated[
    str | None,
    typer.Option(
        help="Point of the endocardium: its number, from 0, or x,y,z in mm.", rich_help_panel=SEEDS
    ),
]


@heart_app.command("build")
def heart_build(
    anatomy: Annotated[
        Path | None,
        typer.Argument(
            help="Closed surface (VTP, VTK, STL, OBJ, PLY), segmentation (NIfTI, NRRD) or "
            "tetrahedra (VTU, VTK, Gmsh, openCARP .pts)."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder to write; without it, named as the file.")
    ] = None,
    edge_length: Annotated[float, typer.Option(help="Mean edge of the mesh (mm).")] = 2.0,
    labels: Annotated[
        str | None,
        typer.Option(
            help="Numbers in the file, as base=1,epicardium=2,lv=3,rv=4 (surfaces) or "
            "lv=1,rv=2,myocardium=3,scar=4 (segmentations).",
            rich_help_panel=ANATOMY,
        ),
    ] = None,
    label_array: Annotated[
        str | None,
        typer.Option(help="Array that holds them; otherwise 'class'.", rich_help_panel=ANATOMY),
    ] = None,
    labels_file: Annotated[
        Path | None,
        typer.Option(help="Labels of an STL: one number a line.", rich_help_panel=ANATOMY),
    ] = None,
    lv_endocardium: Annotated[
        Path | None,
        typer.Option(
            help="Separate surfaces instead of one file; they need not meet exactly.",
            rich_help_panel=ANATOMY,
        ),
    ] = None,
    rv_endocardium: Annotated[Path | None, typer.Option(rich_help_panel=ANATOMY)] = None,
    epicardium: Annotated[Path | None, typer.Option(rich_help_panel=ANATOMY)] = None,
    base: Annotated[
        Path | None,
        typer.Option(help="May be left out: it is made.", rich_help_panel=ANATOMY),
    ] = None,
    lv_angles: Annotated[
        str,
        typer.Option(
            help="Helix angles, endocardium,epicardium (degrees).", rich_help_panel=FIBRES
        ),
    ] = "60,-60",
    rv_angles: Annotated[str, typer.Option(rich_help_panel=FIBRES)] = "90,-25",
    torso: Annotated[
        str,
        typer.Option(
            help="'idealised', 'none' (unbounded conductor), or a closed surface of the skin.",
            rich_help_panel=BODY,
        ),
    ] = "idealised",
    lung: Annotated[
        list[Path] | None,
        typer.Option(help="Closed surface of a lung, with --torso FILE.", rich_help_panel=BODY),
    ] = None,
    height: Annotated[
        float | None, typer.Option(help="Of the person (m).", rich_help_panel=BODY)
    ] = None,
    weight: Annotated[float | None, typer.Option(help="kg.", rich_help_panel=BODY)] = None,
    chest: Annotated[
        float | None, typer.Option(help="Circumference (cm).", rich_help_panel=BODY)
    ] = None,
    pose: Annotated[
        Literal["standard", "ras", "lps"],
        typer.Option(
            help="How the heart lies in the idealised torso: 'standard' by its axes, or 'ras' "
            "(NIfTI) or 'lps' (DICOM) where its coordinates are the patient's.",
            rich_help_panel=BODY,
        ),
    ] = "standard",
    electrodes: Annotated[
        Path | None,
        typer.Option(
            help="Nine electrodes, CSV name,x,y,z or JSON; without it, at the standard places of "
            "the idealised torso.",
            rich_help_panel=BODY,
        ),
    ] = None,
    lv_root: SeedOption = None,
    lv_direction: SeedOption = None,
    rv_root: SeedOption = None,
    rv_direction: SeedOption = None,
) -> None:
    """Build a heart folder from an anatomy: mesh, fibres, seeds, torso, electrodes, lead fields.

    One closed surface, with or without labels; separate surfaces; a segmentation; or a mesh of
    your own. What was found is printed and drawn (check.png in the folder): look at it.

    ```
    fascicle heart build heart.vtp
    fascicle heart build labels.nii.gz --labels lv=1,rv=2,myocardium=3 --pose ras
    fascicle heart build --lv-endocardium lv.stl --rv-endocardium rv.stl --epicardium epi.stl
    ```
    """
    from fascicle.build.pipeline import Body, build_heart
    from fascicle.build.source import Source
    from fascicle.cli.terminal_progress import TerminalProgress
    from fascicle.heart.fibres.rules import FibreAngles
    from fascicle.heart.folder import check_heart_folder

    parts = {
        "lv": lv_endocardium, "rv": rv_endocardium, "epicardium": epicardium, "base": base,
    }  # fmt: skip
    source = Source(
        file=anatomy,
        parts={part: path for part, path in parts.items() if path is not None},
        numbers=_numbers(labels),
        array=label_array,
        labels_file=labels_file,
    )
    lv_endo, lv_epi = _angles("--lv-angles", lv_angles)
    rv_endo, rv_epi = _angles("--rv-angles", rv_angles)
    seeds = _seeds(lv_root, lv_direction, rv_root, rv_direction)
    folder = out if out is not None else Path(source.name)
    given = (anatomy, *parts.values(), labels_file, electrodes, Path(torso), *(lung or ()))
    check_heart_folder(folder, [path for path in given if path is not None and path.is_file()])
    with TerminalProgress() as progress:
        built = build_heart(
            source,
            edge_length=edge_length,
            angles=FibreAngles(lv_endo, lv_epi, rv_endo, rv_epi),
            body=Body(torso, tuple(lung or ()), height, weight, chest, pose, electrodes),
            seeds=seeds,
            name=folder.resolve().name,
            progress=progress,
        )
    for note in built.notes:
        print(note)
    _write_and_check(built.heart, folder)
    if built.anatomy.guessed:
        _draw_labels(built.anatomy.mesh, folder)


@heart_app.command("import")
def heart_import(
    mesh: Annotated[Path, typer.Option(help="Tetrahedral mesh in mm (VTK, VTU, Gmsh).")],
    fibres: Annotated[Path, typer.Option(help="Fibres, one vector a point or a tetrahedron.")],
    lv_endocardium: Annotated[Path, typer.Option(help="LV endocardium, open at the base.")],
    rv_endocardium: Annotated[Path, typer.Option(help="RV endocardium, open at the base.")],
    electrodes: Annotated[Path, typer.Option(help="Nine electrodes: CSV name,x,y,z or JSON.")],
    out: OutOption,
    lv_root: SeedOption = None,
    lv_direction: SeedOption = None,
    rv_root: SeedOption = None,
    rv_direction: SeedOption = None,
) -> None:
    """Make a heart folder of finished parts: mesh, fibres, endocardia, electrodes.

    Surfaces may be VTK, VTP, OBJ, STL, PLY or Gmsh. Fibres are matched by position, so their
    points may come in another order. Without seeds, sensible ones are found on the septal side of
    the base, pointing to the apex. The volume conductor is unbounded; **heart build** adds a torso.
    """
    from fascicle.heart.assembly import assemble_heart
    from fascicle.heart.folder import check_heart_folder
    from fascicle.mesh.formats.read import read_mesh

    check_heart_folder(out, [mesh, fibres, lv_endocardium, rv_endocardium, electrodes])
    heart = assemble_heart(
        mesh=read_mesh(mesh, "mesh"),
        fibres=read_mesh(fibres, "fibres"),
        surfaces={
            "lv": read_mesh(lv_endocardium, "LV endocardium"),
            "rv": read_mesh(rv_endocardium, "RV endocardium"),
        },
        seeds=_seeds(lv_root, lv_direction, rv_root, rv_direction),
        electrodes=electrodes,
        name=out.resolve().name,
    )
    _write_and_check(heart, out, {"lv": lv_endocardium, "rv": rv_endocardium})


@heart_app.command("check")
def heart_check(
    heart: HeartArgument,
    picture: Annotated[
        Path | None,
        typer.Option(help="Picture to write (PNG, PDF, SVG); otherwise check.png in the folder."),
    ] = None,
) -> None:
    """Validate a heart folder; print and draw what it holds, with warnings and their remedies."""
    from fascicle.heart.folder import PICTURE, load_heart
    from fascicle.report.figures import check_picture

    if picture is not None:
        check_picture(picture)
    loaded = load_heart(heart)
    charts = _growable_charts(loaded, {"lv": heart, "rv": heart})
    if picture is None and Path(heart).is_dir():  # the packaged heart has no place for one
        picture = Path(heart) / PICTURE
    _check(loaded, charts, picture)


@heart_app.command("export")
def heart_export(
    heart: HeartArgument,
    out: OutOption,
    kind: Annotated[
        Literal["opencarp", "gmsh", "vtu"],
        typer.Option("--format", help="openCARP in µm, Gmsh and VTU in mm."),
    ] = "opencarp",
) -> None:
    """Write a heart for other software: mesh, fibres, sheets, regions, endocardia, electrodes."""
    from fascicle.build.export import export_heart
    from fascicle.heart.folder import load_heart

    export_heart(load_heart(heart), out, kind)
    print(f"written to {out}")


def _write_and_check(
    heart: Heart, folder: Path, sources: Mapping[str, object] | None = None
) -> None:
    """Write a heart folder with its picture in it, and print what it holds."""
    from fascicle.heart.folder import PICTURE, write_heart

    charts = _growable_charts(heart, sources if sources is not None else {})
    write_heart(heart, folder)
    _check(heart, charts, folder / PICTURE)
    print(f"heart written to {folder}")


def _draw_labels(mesh: LabelledMesh, folder: Path) -> None:
    from fascicle.heart.folder import LABELS_PICTURE
    from fascicle.report.figures import save
    from fascicle.report.labels import labels_figure

    save(labels_figure(mesh), folder / LABELS_PICTURE)
    print(
        f"labels found from the shape: look at {folder / LABELS_PICTURE}; if they are wrong, give "
        "a surface with labels"
    )


def _check(heart: Heart, charts: Mapping[str, Chart], picture: Path | None) -> None:
    from fascicle.build.check import check_heart
    from fascicle.report.check import check_figure
    from fascicle.report.figures import save

    found = check_heart(heart, charts)
    print(heart.name)
    for what, value in found.rows:
        print(f"  {what:<18} {value}")
    for warning in found.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if picture is not None:
        save(check_figure(heart, found), picture)
        print(f"picture: {picture}")
    print(f"{len(found.warnings)} warnings" if found.warnings else "no problem found")


def _growable_charts(heart: Heart, sources: Mapping[str, object]) -> dict[str, Chart]:
    """Build charts and seeds, which is where an endocardium shows what else is wrong with it."""
    from fascicle.purkinje.chart import build_chart
    from fascicle.purkinje.growth import find_seed

    charts = {}
    for endocardium in heart.endocardia:
        try:
            charts[endocardium.side] = build_chart(endocardium)
            find_seed(endocardium, charts[endocardium.side])
        except InputError as error:
            raise InputError(f"{sources.get(endocardium.side, heart.name)}: {error}") from None
    return charts


def _numbers(labels: str | None) -> dict[str, int] | None:
    """Read 'lv=3,rv=4' as names and numbers."""
    if labels is None:
        return None
    numbers: dict[str, int] = {}
    for item in labels.split(","):
        name, _, number = item.partition("=")
        name = name.strip().lower()
        if name in numbers:
            raise InputError(f"--labels {labels}: '{name}' is there twice; give one number each")
        try:
            numbers[name] = int(number)
        except ValueError:
            raise InputError(
                f"--labels {labels}: '{item}' is not a name and a number; write lv=3,rv=4"
            ) from None
    return numbers


def _angles(option: str, text: str) -> tuple[float, float]:
    """Read '60,-60' (degrees), endocardium and epicardium, as rad."""
    values = _floats(text)
    if values is None or len(values) != 2 or max(map(abs, values)) > 90:
        raise InputError(
            f"{option} {text}: give two angles between -90 and 90 degrees, endocardium,epicardium"
        )
    return math.radians(values[0]), math.radians(values[1])


def _seeds(
    lv_root: str | None, lv_direction: str | None, rv_root: str | None, rv_direction: str | None
) -> dict[str, tuple[ChosenSeed, ChosenSeed]]:
    return {
        "lv": (_seed("--lv-root", lv_root), _seed("--lv-direction", lv_direction)),
        "rv": (_seed("--rv-root", rv_root), _seed("--rv-direction", rv_direction)),
    }


def _seed(option: str, text: str | None) -> ChosenSeed:
    if text is None:
        return None
    if re.fullmatch(r"\s*-?\d+\s*", text):
        return int(text)
    values = _floats(text)
    if values is None or len(values) != 3:
        raise InputError(
            f"{option} {text}: give the number of a point of the endocardium, from 0, or its "
            "position x,y,z (mm)"
        )
    return values[0], values[1], values[2]


def _floats(text: str) -> list[float] | None:
    """Finite numbers between commas, or None where they are not."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        return None
    return values if all(map(math.isfinite, values)) else None
