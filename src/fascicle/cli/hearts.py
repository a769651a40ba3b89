"""`fascicle heart …`: build, import, check, refine and export heart folders."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from fascicle.cli import heart_options as options
from fascicle.cli.arguments import HeartArgument, OutOption, SchedulerOption, pool_at
from fascicle.cli.output import Result, every_command
from fascicle.core.errors import InputError

if TYPE_CHECKING:
    from fascicle.core.progress import Progress
    from fascicle.heart.heart import Heart
    from fascicle.heart.labelled_surface import LabelledMesh
    from fascicle.purkinje.chart import Chart

heart_app = typer.Typer(
    no_args_is_help=True,
    help="Build heart folders from an anatomy or a finished mesh; check, refine and export them.",
)


@heart_app.command("build")
@every_command
def heart_build(
    anatomy: options.AnatomyArgument = None,
    out: options.NamedOutOption = None,
    edge_length: options.EdgeLengthOption = 2.0,
    labels: options.LabelsOption = None,
    label_array: options.LabelArrayOption = None,
    labels_file: options.LabelsFileOption = None,
    remesh: options.RemeshOption = False,
    lv_endocardium: options.FirstPartOption = None,
    rv_endocardium: options.PartOption = None,
    epicardium: options.PartOption = None,
    base: options.BaseOption = None,
    lv_angles: options.LvAnglesOption = "60,-60",
    rv_angles: options.RvAnglesOption = "90,-25",
    torso: options.TorsoOption = "idealised",
    lung: options.LungOption = None,
    height: options.HeightOption = None,
    weight: options.WeightOption = None,
    chest: options.ChestOption = None,
    pose: options.PoseOption = "standard",
    electrodes: options.ElectrodesOption = None,
    lv_root: options.SeedOption = None,
    lv_direction: options.SeedOption = None,
    rv_root: options.SeedOption = None,
    rv_direction: options.SeedOption = None,
) -> Result:
    """Build a heart folder from an anatomy: mesh, fibres, seeds, torso, electrodes, lead fields.

    One closed surface, with or without labels; separate surfaces; a segmentation; or a mesh of
    your own. What was found is printed and drawn (check.png in the folder): look at it.

    ```
    fascicle heart build heart.vtp
    fascicle heart build labels.nii.gz --labels lv=1,rv=2,myocardium=3 --pose ras
    fascicle heart build --lv-endocardium lv.stl --rv-endocardium rv.stl --epicardium epi.stl
    ```
    """
    from fascicle.build.anatomy import Source
    from fascicle.build.build_heart import build_heart
    from fascicle.build.torso import TorsoOptions
    from fascicle.cli.output import TerminalProgress
    from fascicle.heart.folder import check_heart_folder

    parts = {"lv": lv_endocardium, "rv": rv_endocardium, "epicardium": epicardium, "base": base}
    source = Source(
        file=anatomy,
        parts={part: path for part, path in parts.items() if path is not None},
        labels=options.label_numbers(labels),
        label_array=label_array,
        labels_file=labels_file,
        remesh=remesh or None,
    )
    angles = options.fibre_angles(lv_angles, rv_angles)
    seeds = options.seeds_of(lv_root, lv_direction, rv_root, rv_direction)
    folder = out if out is not None else Path(source.name)
    files = (anatomy, *parts.values(), labels_file, electrodes, Path(torso), *(lung or ()))
    check_heart_folder(folder, [path for path in files if path is not None and path.is_file()])
    measures = options.known(height=height, weight=weight, chest=chest)
    with TerminalProgress() as progress:
        built = build_heart(
            source,
            edge_length=edge_length,
            angles=angles,
            torso=TorsoOptions(torso, tuple(lung or ()), measures, pose, electrodes),
            seeds=seeds,
            name=folder.resolve().name,
            progress=progress,
        )
    for note in built.notes:
        print(note)
    found = _write_and_check(built.heart, folder)
    if built.anatomy.guessed:
        _draw_labels(built.anatomy.mesh, folder)
    return found | {"notes": built.notes}


@heart_app.command("import")
@every_command
def heart_import(
    mesh: Annotated[Path, typer.Option(help="Tetrahedral mesh in mm (VTK, VTU, Gmsh).")],
    fibres: Annotated[Path, typer.Option(help="Fibres, one vector a point or a tetrahedron.")],
    lv_endocardium: Annotated[Path, typer.Option(help="LV endocardium, open at the base.")],
    rv_endocardium: Annotated[Path, typer.Option(help="RV endocardium, open at the base.")],
    electrodes: Annotated[Path, typer.Option(help="Nine electrodes: CSV name,x,y,z or JSON.")],
    out: OutOption,
    torso: options.TorsoOption = "none",
    lung: options.LungOption = None,
    height: options.HeightOption = None,
    weight: options.WeightOption = None,
    chest: options.ChestOption = None,
    pose: options.PoseOption = "standard",
    lv_root: options.SeedOption = None,
    lv_direction: options.SeedOption = None,
    rv_root: options.SeedOption = None,
    rv_direction: options.SeedOption = None,
) -> Result:
    """Make a heart folder of finished parts: mesh, fibres, endocardia, electrodes.

    Surfaces may be VTK, VTP, OBJ, STL, PLY or Gmsh. Fibres are matched by position, so their
    points may come in another order. Without seeds, sensible ones are found on the septal side of
    the base, pointing to the apex. Without **--torso idealised** the volume conductor is unbounded,
    and the ratios of the leads are wrong.
    """
    from fascicle.build.torso import TorsoOptions, in_torso
    from fascicle.cli.output import TerminalProgress
    from fascicle.heart.assembly import assemble_heart
    from fascicle.heart.folder import check_heart_folder
    from fascicle.heart.labelled_surface import labelled_mesh
    from fascicle.mesh.formats.read import read_mesh

    check_heart_folder(out, [mesh, fibres, lv_endocardium, rv_endocardium, electrodes])
    measures = options.known(height=height, weight=weight, chest=chest)
    surrounding = TorsoOptions(torso, tuple(lung or ()), measures, pose, electrodes)
    heart = assemble_heart(
        mesh=read_mesh(mesh, "mesh"),
        fibres=read_mesh(fibres, "fibres"),
        surfaces={
            "lv": read_mesh(lv_endocardium, "LV endocardium"),
            "rv": read_mesh(rv_endocardium, "RV endocardium"),
        },
        seeds=options.seeds_of(lv_root, lv_direction, rv_root, rv_direction),
        electrodes=electrodes,
        name=out.resolve().name,
    )
    with TerminalProgress() as progress:
        heart, notes = in_torso(heart, labelled_mesh(heart), surrounding, progress)
    for note in notes:
        print(note)
    found = _write_and_check(heart, out, {"lv": lv_endocardium, "rv": rv_endocardium})
    return found | {"notes": notes}


@heart_app.command("check")
@every_command
def heart_check(
    heart: HeartArgument,
    picture: Annotated[
        Path | None,
        typer.Option(help="Picture to write (PNG, PDF, SVG); otherwise check.png in the folder."),
    ] = None,
) -> Result:
    """Validate a heart folder; print and draw what it holds, with warnings and their remedies.

    Points are numbers of an endocardium's vertices, as --lv-root and --lv-direction of 'heart
    build' take them. What the lines mean stands in docs/hearts.md.
    """
    from fascicle.core.files import check_writable
    from fascicle.heart.folder import PICTURE, load_heart
    from fascicle.reporting.figures import check_picture

    if picture is not None:
        check_picture(picture)
    loaded = load_heart(heart)
    if picture is None and Path(heart).is_dir():  # the packaged heart has no place for one
        picture = Path(heart) / PICTURE
    if picture is not None:
        check_writable(picture, "--picture")
    charts = _growable_charts(loaded, {"lv": heart, "rv": heart})
    return _check(loaded, charts, picture)


@heart_app.command("refine")
@every_command
def heart_refine(heart: HeartArgument, out: OutOption) -> Result:
    """Cut every tetrahedron of a heart into eight, and say what that costs.

    Activation times, and the ECG with them, have an error that halves with the edge length; see
    docs/error-budget.md. Fibres, regions and lead fields are those of the coarser mesh; endocardia,
    electrodes and bundles stay. The torso is left out: the lead fields stand in the mesh.
    """
    from fascicle.build.refinement import refined
    from fascicle.cli.output import TerminalProgress
    from fascicle.heart.folder import MANIFEST, check_heart_folder, load_heart

    check_heart_folder(out, [Path(heart) / MANIFEST])
    coarse = load_heart(heart)
    with TerminalProgress() as progress:
        finer = refined(coarse, progress)
    found = _write_and_check(finer, out)
    hearts = coarse, load_heart(out)  # what is prepared for it is then kept beside it
    with TerminalProgress() as progress:
        costs = [_forward_run_time(each, progress) for each in hearts]
    rows = {
        "tetrahedra": [str(len(each.tetrahedra)) for each in hearts],
        "mean edge, mm": [f"{each.edge_length:.2f}" for each in hearts],
        "forward run, ms": [f"{cost:.1f}" if cost is not None else "-" for cost in costs],
    }
    print(f"{'':<18} {'before':>9} {'after':>9}")
    for what, (before, after) in rows.items():
        print(f"{what:<18} {before:>9} {after:>9}")
    return found | {"forward_run_ms": dict(zip(("before", "after"), costs, strict=True))}


@heart_app.command("simulate-prior")
@every_command
def heart_simulate_prior(
    heart: HeartArgument,
    networks: Annotated[
        int | None,
        typer.Option(
            "--networks", min=1, help="Networks of the prior; by default as a fit begins with."
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", min=1, help="Simulations at a time; one a core.")
    ] = None,
    scheduler: SchedulerOption = None,
) -> Result:
    """Simulate networks of the prior once, so that fits of this heart are done sooner.

    They are kept in the heart's folder and serve every recording, as long as the fit learns the
    usual parameters with their usual ranges. Interrupt it whenever you like: the same command goes
    on where it stopped, and a larger number adds to what is there.
    """
    from fascicle.cli.output import TerminalProgress
    from fascicle.study.prior_simulations import simulate_prior

    with TerminalProgress() as progress:
        pool = pool_at(scheduler, progress)
        folder = simulate_prior(heart, networks, workers=workers, progress=progress, pool=pool)
    print(f"prior simulations in {folder}")
    return {"prior_simulations": folder}


@heart_app.command("export")
@every_command
def heart_export(
    heart: HeartArgument,
    out: OutOption,
    kind: Annotated[
        Literal["opencarp", "gmsh", "vtu"],
        typer.Option("--format", help="openCARP in µm, Gmsh and VTU in mm."),
    ] = "opencarp",
) -> Result:
    """Write a heart for other software: mesh, fibres, sheets, regions, endocardia, electrodes."""
    from fascicle.build.export import export_heart
    from fascicle.heart.folder import load_heart

    export_heart(load_heart(heart), out, kind)
    print(f"written to {out}")
    return {"folder": out, "format": kind}


def _write_and_check(
    heart: Heart, folder: Path, sources: Mapping[str, object] | None = None
) -> dict[str, Any]:
    """Write a heart folder with its picture in it, and print what it holds."""
    from fascicle.heart.folder import PICTURE, write_heart

    charts = _growable_charts(heart, sources if sources is not None else {})
    write_heart(heart, folder)
    found = _check(heart, charts, folder / PICTURE)
    print(f"heart written to {folder}")
    return {"folder": folder} | found


def _forward_run_time(heart: Heart, progress: Progress) -> float | None:
    from fascicle.forward.compile_kernels import compile_kernels
    from fascicle.forward.example import forward_run_time
    from fascicle.forward.model import ForwardModel

    compile_kernels(progress)
    return forward_run_time(ForwardModel(heart, progress=progress))


def _draw_labels(mesh: LabelledMesh, folder: Path) -> None:
    from fascicle.heart.folder import LABELS_PICTURE
    from fascicle.reporting.figures import save
    from fascicle.reporting.labels import labels_figure

    save(labels_figure(mesh), folder / LABELS_PICTURE)
    print(
        f"labels found from the shape: look at {folder / LABELS_PICTURE}; if they are wrong, give "
        "a surface with labels"
    )


def _check(heart: Heart, charts: Mapping[str, Chart], picture: Path | None) -> dict[str, Any]:
    from fascicle.build.check import check_heart
    from fascicle.reporting.check import check_figure
    from fascicle.reporting.figures import save

    found = check_heart(heart, charts)
    print(heart.name)
    for what, value in found.rows:
        print(f"  {what:<18} {value}")
    for warning in found.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if picture is not None:
        save(check_figure(heart, found), picture)
        print(f"picture: {picture}")
    count = len(found.warnings)
    print(f"{count} warning{'s' * (count > 1)}" if count else "no problem found")
    found_rows = dict(found.rows)
    return {
        "heart": heart.name,
        "found": found_rows,
        "warnings": found.warnings,
        "picture": picture,
    }


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
