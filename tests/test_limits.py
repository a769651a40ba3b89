"""Files that state or unpack to more than any mesh, segmentation or recording has.

Each is read in a process of its own, so that the memory it takes can be seen.
"""

import base64
import gzip
import json
import os
import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest
import scipy.io

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
MOST = 1.6  # GB: a child may take 1.5; what follows asks for 3 GB and more
READ = """
import json, resource, sys
from fascicle.build.segmentation_files import read_segmentation
from fascicle.core import isolated
from fascicle.core.errors import InputError
from fascicle.mesh.read import read_mesh
from fascicle.recording.readers.read import read_recording
for function, path in zip(sys.argv[1::2], sys.argv[2::2]):
    try:
        eval(function)(path)
        message = ""
    except InputError as error:
        message = str(error)
    isolated.end_child()
    # not RUSAGE_SELF, which on Linux holds what the parent took before this program began
    own = next(line for line in open("/proc/self/status") if line.startswith("VmHWM:")).split()[1]
    peak = max(int(own), resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
    print(json.dumps([message, peak / 2**20]))
"""


def refused(function, *paths):
    """The messages with which files are refused by a process that stays small."""
    arguments = [each for path in paths for each in (function, str(path))]
    done = subprocess.run(
        [sys.executable, "-c", READ, *arguments],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert not done.stderr
    messages = []
    for path, line in zip(paths, done.stdout.splitlines(), strict=True):
        message, peak = json.loads(line)
        assert message.startswith(f"{path}: ")
        assert message.isprintable()
        assert peak < MOST
        messages.append(message)
    return messages


def zeros(total, size=2**22):
    """A VTK array of that many zeros as base64: one block many times, as XML files have them."""
    packed = zlib.compress(bytes(size))
    head = struct.pack("<3Q", total // size, size, 0) + struct.pack("<Q", len(packed)) * (
        total // size
    )
    return (base64.b64encode(head) + base64.b64encode(packed * (total // size))).decode()


def vtu(points, positions, form):
    cells = "".join(
        f'<DataArray type="{kind}" Name="{name}" format="ascii">{values}</DataArray>'
        for name, kind, values in (
            ("connectivity", "Int64", "0 1 2 3"), ("offsets", "Int64", 4), ("types", "UInt8", 10),
        )
    )  # fmt: skip
    return (
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64" compressor="vtkZLibDataCompressor"><UnstructuredGrid>'
        f'<Piece NumberOfPoints="{points}" NumberOfCells="1"><Points>'
        f'<DataArray type="Float64" NumberOfComponents="3" format="{form}">{positions}</DataArray>'
        f"</Points><Cells>{cells}</Cells></Piece></UnstructuredGrid></VTKFile>"
    )


def test_meshes_that_state_or_unpack_to_more_than_they_may(tmp_path):
    states, unpacks, legacy = (tmp_path / name for name in ("a.vtu", "b.vtu", "c.vtk"))
    states.write_text(vtu(9_000_000_000_000, "0 0 0", "ascii"))
    points = 2**27
    unpacks.write_text(vtu(points, zeros(24 * points), "binary"))
    assert unpacks.stat().st_size < 5 * 2**20
    head = "# vtk DataFile Version 3.0\na\nBINARY\nDATASET UNSTRUCTURED_GRID\n"
    legacy.write_text(f"{head}POINTS 900000000000 double\n" + "0" * 100)
    one, other, _ = refused("read_mesh", states, unpacks, legacy)
    assert "takes more than 1.5 GB of memory, the limit for a file of" in one
    assert "GB of memory, the limit for a file of" in other


def test_recording_that_unpacks_to_more_than_it_may(tmp_path):
    """A variable of 3 GB of zeros in 3 MB."""
    path = tmp_path / "a.mat"
    samples = 400_000_000
    scipy.io.savemat(path, {"V1": np.zeros((1, 1000))})
    content = path.read_bytes().replace(struct.pack("<2i", 1, 1000), struct.pack("<2i", 1, samples))
    content = content.replace(struct.pack("<2I", 9, 8000), struct.pack("<2I", 9, 8 * samples))
    variable = content[128:136][:4] + struct.pack("<I", 8 * samples + 56) + content[136:-8000]
    packer = zlib.compressobj()
    head = packer.compress(variable) + packer.flush(zlib.Z_FULL_FLUSH)
    block = packer.compress(bytes(2**20)) + packer.flush(zlib.Z_FULL_FLUSH)
    packed = head + block * (8 * samples // 2**20)
    path.write_bytes(content[:128] + struct.pack("<2I", 15, len(packed)) + packed)
    assert "unpack" in refused("read_recording", path)[0]


def nrrd_header(sizes):
    return (
        "NRRD0004\ntype: uint8\ndimension: 3\nspace: left-posterior-superior\n"
        f"sizes: {sizes}\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nencoding: gzip\n\n"
    ).encode()


def test_segmentations_that_hold_more_or_less_than_they_state(tmp_path):
    more, less, least = (tmp_path / f"{name}.nrrd" for name in "abc")
    packer = zlib.compressobj(wbits=31)
    head = packer.compress(bytes(2**24)) + packer.flush(zlib.Z_FULL_FLUSH)
    block = packer.compress(bytes(2**24)) + packer.flush(zlib.Z_FULL_FLUSH)
    more.write_bytes(nrrd_header("256 256 256") + head + block * 200)
    for path, sizes in ((less, "1024 512 512"), (least, "1024 1024 1024")):
        path.write_bytes(nrrd_header(sizes) + gzip.compress(bytes(2**24)))
    said, *others = refused("read_segmentation", more, less, least)
    # of memory, or on a slow machine of computing
    assert "the limit for a file of" in said
    assert all("damaged, truncated or mislabelled" in other for other in others)
