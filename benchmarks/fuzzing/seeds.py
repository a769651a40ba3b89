"""Small whole files of every kind, from which damaged ones are made."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from fascicle.core.leads import LEADS

if TYPE_CHECKING:
    from fascicle.heart.heart import Heart

RATE = 250  # Hz


@dataclass(frozen=True)
class Seed:
    """Files that are read together.

    Attributes
    ----------
    files : dict of path to bytes
        Relative to the folder they are put in.
    main : str
        What is read: one of the files, or empty for the folder.
    damaged : tuple of str
        Which files may be damaged.
    packed : tuple of str
        Files that are damaged before they are compressed by gzip.
    """

    files: dict[str, bytes]
    main: str
    damaged: tuple[str, ...]
    packed: tuple[str, ...] = ()


def _written(write: Callable[[Path], None]) -> dict[str, bytes]:
    """All files that a function writes into a folder."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        write(folder)
        paths = sorted(path for path in folder.rglob("*") if path.is_file())
        return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def _each(files: dict[str, bytes]) -> list[Seed]:
    return [Seed({name: content}, name, (name,)) for name, content in files.items()]


def meshes() -> list[Seed]:
    """Tetrahedra, triangles and lines in every format."""
    return [*_each(_written(_write_meshes)), _opencarp_mesh()]


def _write_meshes(folder: Path) -> None:
    import meshio
    import pyvista as pv

    block = pv.ImageData(dimensions=(3, 3, 3), spacing=(15, 15, 15))
    grid = block.cast_to_unstructured_grid().triangulate()
    grid.clear_data()
    rng = np.random.default_rng(0)
    grid.cell_data["fibre"] = rng.standard_normal((grid.n_cells, 3))
    grid.cell_data["region"] = rng.integers(0, 3, grid.n_cells)
    grid.point_data["lead_field_RA"] = rng.standard_normal(grid.n_points)
    sheet = pv.Plane(i_resolution=3, j_resolution=3, i_size=40, j_size=40).triangulate()
    sheet.clear_data()
    lines = pv.PolyData(np.eye(4, 3) * 30, lines=[2, 0, 1, 3, 1, 2, 3])
    for name, data in (("tissue", grid), ("surface", sheet), ("tree", lines)):
        for mode in ("ascii", "binary"):
            data.save(folder / f"{name}-{mode}.vtk", binary=mode == "binary")
    for name, data, suffix in (("tissue", grid, "vtu"), ("surface", sheet, "vtp"),
                               ("tree", lines, "vtp")):  # fmt: skip
        for mode in ("ascii", "binary", "appended", "raw"):
            _write_xml(folder / f"{name}-{mode}.{suffix}", data, mode)
    for suffix in ("ply", "stl"):
        for mode in ("ascii", "binary"):
            sheet.save(folder / f"surface-{mode}.{suffix}", binary=mode == "binary")
    pv.save_meshio(folder / "surface.obj", sheet)
    mesh = meshio.Mesh(
        np.asarray(grid.points, float), [("tetra", grid.cells_dict[10])],
        cell_data={"gmsh:physical": [np.ones(grid.n_cells, int)],
                   "gmsh:geometrical": [np.ones(grid.n_cells, int)]},
    )  # fmt: skip
    for version in ("gmsh22", "gmsh"):
        for mode in ("ascii", "binary"):
            path = folder / f"{version}-{mode}.msh"
            meshio.write(path, mesh, file_format=version, binary=mode == "binary")


def _write_xml(path: Path, data: Any, mode: str) -> None:
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

    writer: Any = (
        vtkXMLPolyDataWriter() if path.suffix == ".vtp" else vtkXMLUnstructuredGridWriter()
    )
    writer.SetInputData(data)
    writer.SetFileName(str(path))
    if mode == "ascii":
        writer.SetDataModeToAscii()
    elif mode == "binary":
        writer.SetDataModeToBinary()
    else:
        writer.SetDataModeToAppended()
        writer.SetEncodeAppendedData(mode == "appended")
    if mode == "raw":
        writer.SetCompressorTypeToNone()
    writer.Write()


def _opencarp_mesh() -> Seed:
    rng = np.random.default_rng(0)
    points = "\n".join(" ".join(f"{x:.3f}" for x in row) for row in rng.normal(0, 3e4, (9, 3)))
    corners = [rng.permutation(9)[:4] for _ in range(12)]
    elements = "\n".join("Tt " + " ".join(map(str, row)) + " 1" for row in corners)
    fibres = "\n".join(" ".join(f"{x:.3f}" for x in row) for row in rng.normal(0, 1, (12, 6)))
    files = {
        "mesh.pts": f"9\n{points}\n".encode(),
        "mesh.elem": f"12\n{elements}\n".encode(),
        "mesh.lon": f"2\n{fibres}\n".encode(),
    }
    return Seed(files, "mesh.elem", tuple(files))


def segmentations() -> list[Seed]:
    """A label map as NIfTI and NRRD."""
    files = _written(_write_segmentations)
    seeds = [Seed({name: files[name]}, name, (name,)) for name in files if "apart" not in name]
    seeds += [replace(seed, packed=(seed.main,)) for seed in seeds if seed.main.endswith(".gz")]
    for header, data in (("apart.nhdr", "apart.raw"), ("apart-gz.nhdr", "apart-gz.raw.gz")):
        seeds.append(Seed({name: files[name] for name in (header, data)}, header, (header, data)))
    return seeds


def _write_segmentations(folder: Path) -> None:
    import nibabel
    import nrrd

    labels = np.zeros((8, 7, 6), np.int16)
    labels[2:5, 2:5, 1:5], labels[5:7, 2:5, 1:5], labels[1, 2:5, 1:5] = 1, 2, 3
    affine = np.diag([12.0, 12.0, 15.0, 1.0])
    for name, kind in (("a.nii", np.int16), ("a.nii.gz", np.uint8), ("b.nii", np.float64)):
        image = nibabel.Nifti1Image(labels.astype(kind), affine)
        image.set_sform(affine, code=1)
        image.header.set_xyzt_units("mm")
        nibabel.save(image, folder / name)
    nibabel.save(nibabel.Nifti2Image(labels, affine), folder / "c.nii")
    header = {"space": "left-posterior-superior", "space directions": affine[:3, :3],
              "space origin": np.zeros(3)}  # fmt: skip
    for name, encoding in (("raw.nrrd", "raw"), ("gzip.nrrd", "gzip"), ("bzip2.nrrd", "bzip2"),
                           ("text.nrrd", "ASCII"), ("apart.nhdr", "raw"),
                           ("apart-gz.nhdr", "gzip")):  # fmt: skip
        nrrd.write(str(folder / name), labels, header | {"encoding": encoding})


def recordings() -> list[Seed]:
    """Two seconds of twelve leads in every format."""
    files = _written(_write_recordings)
    records = [name.removesuffix(".hea") for name in files if name.endswith(".hea")]
    seeds = [
        Seed({name: content}, name, (name,))
        for name, content in files.items()
        if Path(name).stem not in records
    ]
    for record in records:
        pair = {name: files[name] for name in (f"{record}.hea", f"{record}.dat")}
        seeds.append(Seed(pair, f"{record}.hea", tuple(pair)))
    return seeds


def _signal() -> np.ndarray:
    """(12, n) mV."""
    from fascicle.core.leads import lead_matrix

    t = np.arange(2 * RATE) / RATE
    beat = np.exp(-(((t % 1.0 - 0.5) / 0.02) ** 2))
    return lead_matrix() @ (beat * np.linspace(-1, 1.5, 9)[:, None])


def _write_recordings(folder: Path) -> None:
    import edfio
    import h5py
    import pandas as pd
    import scipy.io
    import wfdb

    signal = _signal()
    named = dict(zip(LEADS, signal, strict=True))
    for form in ("16", "212"):
        wfdb.wrsamp(
            f"wfdb{form}", fs=RATE, units=["mV"] * 12, sig_name=list(LEADS), p_signal=signal.T,
            fmt=[form] * 12, adc_gain=[200.0] * 12, baseline=[0] * 12, write_dir=str(folder),
        )  # fmt: skip
    for name, options in (("plain", {}), ("packed", {"do_compression": True}),
                          ("old", {"format": "4"})):  # fmt: skip
        scipy.io.savemat(folder / f"{name}.mat", named | {"fs": RATE, "units": "mV"}, **options)
    for name, options in (("plain", {}), ("packed", {"compression": "gzip"})):
        with h5py.File(folder / f"{name}.h5", "w") as file:
            file.create_dataset("ecg", data=signal, **options)
            file["leads"] = list(LEADS)
            file.attrs.update(fs=RATE, units="mV")
    table = pd.DataFrame({"time_s": np.arange(signal.shape[1]) / RATE} | named).round(4)
    in_mv = {lead: f"{lead} (mV)" for lead in LEADS}
    table.rename(columns=in_mv).to_csv(folder / "a.csv", index=False)
    cells = table[list(LEADS)].to_csv(index=False, sep="\t")
    (folder / "commented.tsv").write_text(f"# fs: {RATE}\n# units: mV\n{cells}")
    edfio.Edf([
        edfio.EdfSignal(row, RATE, label=f"ECG {lead}", physical_dimension="mV",
                        physical_range=(-4, 4))
        for lead, row in named.items()
    ]).write(folder / "a.edf")  # fmt: skip
    _write_dicom(folder / "a.dcm", signal)
    _write_clinical(folder)


def _write_dicom(path: Path, signal: np.ndarray) -> None:
    import pydicom
    from pydicom.uid import ExplicitVRLittleEndian, TwelveLeadECGWaveformStorage

    def dataset(**elements: Any) -> pydicom.Dataset:
        made = pydicom.Dataset()
        for name, value in elements.items():
            setattr(made, name, value)
        return made

    def coded(value: str, scheme: str, meaning: str) -> list[pydicom.Dataset]:
        code = dataset(CodeValue=value, CodingSchemeDesignator=scheme, CodeMeaning=meaning)
        return [code]

    channels = [
        dataset(
            ChannelSourceSequence=coded(f"lead {lead}", "99X", lead),
            ChannelSensitivity="0.005",
            ChannelSensitivityUnitsSequence=coded("mV", "UCUM", "millivolt"),
            ChannelSensitivityCorrectionFactor="1",
            ChannelBaseline="0",
            WaveformBitsStored=16,
        )
        for lead in LEADS
    ]
    group = dataset(
        NumberOfWaveformChannels=12,
        NumberOfWaveformSamples=signal.shape[1],
        SamplingFrequency=str(RATE),
        ChannelDefinitionSequence=channels,
        WaveformBitsAllocated=16,
        WaveformSampleInterpretation="SS",
        WaveformData=np.rint(signal.T / 0.005).astype("<i2").tobytes(),
    )
    file = dataset(
        SOPClassUID=TwelveLeadECGWaveformStorage, SOPInstanceUID="1.2.3", Modality="ECG",
        WaveformSequence=[group],
    )  # fmt: skip
    file.file_meta = pydicom.dataset.FileMetaDataset()
    file.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    file.file_meta.MediaStorageSOPClassUID = TwelveLeadECGWaveformStorage
    file.file_meta.MediaStorageSOPInstanceUID = "1.2.3"
    file.save_as(path, enforce_file_format=True)


def _write_clinical(folder: Path) -> None:
    """Formats whose writers the tests have."""
    from tests.recording.readers import clinical_files

    digits = clinical_files.heart_beats(samples=600)
    (folder / "aecg.xml").write_text(clinical_files.aecg(digits))
    (folder / "muse.xml").write_text(clinical_files.muse(digits))
    (folder / "plain.scp").write_bytes(clinical_files.scp(digits))


def unpacked(seed: Seed, name: str) -> bytes:
    """Content of a file to damage, decompressed if it is packed."""
    content = seed.files[name]
    return gzip.decompress(content) if name in seed.packed else content


def packed(seed: Seed, name: str, content: bytes) -> bytes:
    """Content as it is stored in a file, compressed if it is packed."""
    return gzip.compress(content, mtime=0) if name in seed.packed else content


SIZE, CELLS = 80.0, 4  # mm; a face holds a tree


def small_heart() -> Heart:
    """A block with an endocardium on its left and right face, which is read in 20 ms."""
    import pyvista as pv

    from fascicle.heart.endocardium import Endocardium
    from fascicle.heart.heart import Heart
    from fascicle.mesh.measures import signed_volumes
    from fascicle.mesh.topology import boundary_triangles

    block = pv.ImageData(dimensions=(CELLS + 1,) * 3, spacing=(SIZE / CELLS,) * 3)
    grid = block.cast_to_unstructured_grid().triangulate()
    vertices = np.asarray(grid.points, float)
    cells = grid.cells_dict[10].astype(np.int64)
    inverted = signed_volumes(vertices, cells) < 0
    cells[inverted] = cells[inverted][:, [1, 0, 2, 3]]
    triangles, _ = boundary_triangles(cells)

    def face(side: str, x: float) -> Endocardium:
        on_face = (vertices[triangles][:, :, 0] == x).all(axis=1)
        used, corners = np.unique(triangles[on_face], return_inverse=True)
        root, middle = (
            int(np.linalg.norm(vertices[used] - (x, SIZE / 2, z), axis=1).argmin())
            for z in (0.75 * SIZE, 0.5 * SIZE)
        )
        return Endocardium(side, vertices[used], corners.reshape(-1, 3)[:, ::-1], root, middle)

    rng = np.random.default_rng(0)
    count = len(cells)
    axes = np.tile(np.eye(3), (count, 1, 1))
    electrodes = SIZE / 2 + 100.0 * rng.choice([-1.0, 1.0], (9, 3)) + rng.normal(0, 10, (9, 3))
    return Heart(
        vertices, cells, axes[:, 1], face("lv", 0.0), face("rv", SIZE), electrodes, "small",
        regions=rng.integers(0, 2, count), sheets=axes[:, 0],
        values={"alpha": 0.07, "region_1_conductivity": 0.5},
    )  # fmt: skip


def hearts() -> list[Seed]:
    """Heart folders, with meshes in text and compressed."""
    from fascicle.heart.folder import write_heart

    packed = _written(lambda folder: write_heart(small_heart(), folder / "heart"))
    text = packed | _written(lambda folder: _as_text(packed, folder))
    names = tuple(packed)
    texts = tuple(name for name in names if name.endswith((".toml", ".csv")))
    # the manifest is damaged as often as the mesh
    return [Seed(text, "heart", names + texts), Seed(packed, "heart", names)]


def _as_text(files: dict[str, bytes], folder: Path) -> None:
    """The VTK files among these, with numbers as text."""
    import pyvista as pv

    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        if path.suffix in (".vtu", ".vtp"):
            path.write_bytes(content)
            _write_xml(path, pv.read(path), "ascii")


def parameters() -> dict[str, float]:
    """Of a network that fits the small heart."""
    from fascicle.core.parameters import EXAMPLE_PARAMETERS

    lengths = {f"{side}_initial_length": 30.0 for side in ("lv", "rv")}
    lengths |= {f"{side}_fascicle_length_{k}": 15.0 for side in ("lv", "rv") for k in (1, 2)}
    return EXAMPLE_PARAMETERS | lengths


def parameter_files() -> list[Seed]:
    """Parameters of a network."""
    text = "".join(f"{name} = {value}\n" for name, value in parameters().items())
    more = "his_time = 40.0\nalpha = 0.07\nregion_1_conductivity = 0.5\nbranch_length = 8.0\n"
    return _each({"a.toml": text.encode(), "b.toml": (text + more).encode()})


SETTINGS = """effective = 100
prior_simulations = 500
workers = 1
seed = 3
gain_sd = 0.2
method = "posterior"

[parameters]
cv = 2.5
alpha = { prior = "log-normal", median = 0.07, sd = 0.2 }
root_time = { lower = -120.0, upper = 0.0 }
endocardial_speed = "free"
endocardial_layer = 1.5
lv_fascicles = 2
region_1_conductivity = { prior = "uniform", lower = 0.0, upper = 0.5 }
"""


def settings_files() -> list[Seed]:
    """Settings of a fit."""
    return _each({"settings.toml": SETTINGS.encode()})


SCENARIO = """description = "everything"
delay.anterograde = 2.0
delay.retrograde = inf

[his]
time = 0.0
root_time = -10.0
left = 0.5
right = 1.0

[[stimulus]]
time = 3.5
position = [0.0, 40.0, 40.0]
radius = 2.0

[[stimulus]]
time = 10.0
site = "rv apex"

[[stimulus]]
time = 0.0
position = [80.0, 40.0, 55.0]
tree = "rv"
part = "bundle"

[[slow_conduction]]
tree = "lv"
part = "fascicle 1"
speed = 0.5

[[slow_conduction]]
tree = "rv"
speed = 0.0
centre = [80.0, 40.0, 40.0]
radius = 10.0

[[region]]
conductivity = 0.25
label = 1

[[region]]
conductivity = 0.0
centre = [40.0, 40.0, 40.0]
radius = 15.0
"""
OWN_TREE = """[[inactive_root]]
tree = "rv"

[[tree]]
name = "own"
file = "tree.vtp"
time = 0.0
root = [30.0, 0.0, 0.0]
"""


def scenarios() -> list[Seed]:
    """Scenarios, one with a tree of its own."""
    from fascicle.forward.scenario_files import library

    shipped = {path.name: path.read_bytes() for path in library().values()}
    tree = _written(_write_meshes)["tree-ascii.vtp"]
    whole = {"own.toml": OWN_TREE.encode(), "tree.vtp": tree}
    plain = _each({"a.toml": SCENARIO.encode()})
    return [*plain * 20, *[Seed(whole, "own.toml", tuple(whole))] * 10, *_each(shipped)]


def trees() -> list[Seed]:
    """Trees of lines."""
    return [seed for seed in meshes() if seed.main.startswith("tree")]


def electrodes() -> list[Seed]:
    """The nine electrodes as CSV and JSON."""
    from fascicle.heart.electrodes import write_electrodes

    places = np.random.default_rng(0).normal(0, 100, (9, 3)).round(2)

    def write(folder: Path) -> None:
        write_electrodes(folder / "a.csv", places)
        write_electrodes(folder / "a.json", places)

    return _each(_written(write))


@cache
def _study_files() -> dict[str, bytes]:
    """Files that `load_study` reads, of studies by both methods with the small heart."""
    import fascicle
    from fascicle.heart.folder import write_heart
    from fascicle.recording.target import Target, smooth_noise

    values = parameters()

    def write(folder: Path) -> None:
        write_heart(small_heart(), folder / "heart")
        heart = fascicle.load_heart(folder / "heart")
        simulated = fascicle.ForwardModel(heart).simulate(values)
        clean = np.pad(simulated.leads, ((0, 0), (80, 80)))
        time = np.arange(clean.shape[1]) - 80 + simulated.onset
        beats = clean + smooth_noise(np.random.default_rng(0), (3, *clean.shape), 0.02)
        last = float(np.nanmax(simulated.activation))
        target = Target(beats, time, simulated.first_activation, last, 60.0, {"from": "it"}, 4.0, 5)
        fixed = {name: value for name, value in values.items() if name != "cv"}
        few = {"paper": {"initial": 6, "steps": 1, "samples": 2, "draws": 2000},
               "posterior": {"prior_simulations": 100, "effective": 20}}  # fmt: skip
        for method, settings in few.items():
            fascicle.fit(
                heart, target, folder / method, parameters=fixed, method=method, workers=1,
                **settings,
            )  # fmt: skip

    files = _written(write)
    unread = ("networks/", "activation.vtu", "summary.json", ".study.lock")
    return {
        name: content for name, content in files.items()
        if not any(part in name for part in unread) and not name.startswith("heart")
    }  # fmt: skip


def studies() -> list[Seed]:
    """Finished studies, by both methods."""
    files = _study_files()
    return [
        Seed(study, method, tuple(study))
        for method in ("paper", "posterior")
        if (study := {name: files[name] for name in files if name.startswith(f"{method}/")})
    ]


def targets() -> list[Seed]:
    """A target."""
    return _each({"target.nc": _study_files()["paper/target.nc"]})


def results() -> list[Seed]:
    """Networks of both methods."""
    files = _study_files()
    return _each({
        name.replace("/", "-"): content for name, content in files.items()
        if name.endswith((".nc",)) and "target" not in name
    })  # fmt: skip
