"""One rendered face with its ground truth and light transport, as one EXR file."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.base.checks import BadInput, check_shape
from sfsnet_dr.base.imageio import read_exr, write_exr
from sfsnet_dr.sh.coefficients import Radiance
from sfsnet_dr.sh.kernel import order_of

Array = NDArray[np.float32]

#: Version of the layout below; a file of another version is refused.
VERSION: Final = 1

#: Prefix of every metadata key.
PREFIX: Final = "sfsnet_dr:"

_VECTORS: Final = {"normal": "XYZ", "albedo": "RGB", "reference": "RGB", "variance": "RGB"}
_SCALARS: Final = ("mask", "coverage")


@dataclass(frozen=True)
class BundleMeta:
    """What a bundle's numbers belong to.

    Args:
        seed: the seed that, with the spec, gives this face again.
        face_model: name of the face model.
        spec_hash: hash of the specification that the whole dataset shares.
        light: radiance coefficients of the light of ``reference`` (K, 3).
        extra: anything JSON can hold: samples per pixel, light directions, pose, versions.
    """

    seed: int
    face_model: str
    spec_hash: str
    light: Radiance
    extra: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Bundle:
    """Ground truth of one face in the canonical frame; linear Rec. 709, row 0 on top.

    Args:
        normal: unit vectors in the camera frame, (H, W, 3); 0 where nothing is hit.
        albedo: reflectance in [0, 1], (H, W, 3).
        mask: share of the pixel that is face skin which counts, in [0, 1], (H, W).
        coverage: share of the pixel that the head covers, in [0, 1], (H, W).
        reference: path-traced image under ``meta.light``, (H, W, 3).
        variance: variance of the mean ``reference``, (H, W, 3).
        transport: linear image that the light of radiance Y_k alone gives, albedo and visibility
            included, (K, H, W, 3); may be negative, for a basis function is.
        meta: what the numbers belong to.

    Raises:
        BadInput: if a shape does not fit the others, or a value is NaN or infinite.
    """

    normal: Array
    albedo: Array
    mask: Array
    coverage: Array
    reference: Array
    variance: Array
    transport: Array
    meta: BundleMeta

    def __post_init__(self) -> None:
        sizes = check_shape("normal", self.normal, "H W 3")
        for name in ("albedo", "reference", "variance"):
            check_shape(name, getattr(self, name), "H W 3", **sizes)
        for name in _SCALARS:
            check_shape(name, getattr(self, name), "H W", **sizes)
        order_of(check_shape("transport", self.transport, "K H W 3", **sizes)["K"])
        for name in (*_VECTORS, *_SCALARS, "transport"):
            if not np.isfinite(getattr(self, name)).all():
                raise BadInput(f"{name}: NaN or inf found, finite values are needed")


def write_bundle(path: Path | str, bundle: Bundle) -> None:
    """Write an EXR, whole or not at all; the same bundle gives the same bytes.

    Channels are half floats, ``variance`` float32: squared noise falls below the smallest half.
    """
    channels: dict[str, Array] = {}
    for name, letters in _VECTORS.items():
        channels |= _planes(name, letters, getattr(bundle, name))
    for name in _SCALARS:
        channels[f"{name}.Y"] = getattr(bundle, name)
    for k, image in enumerate(bundle.transport):
        channels |= _planes(f"transport.{k:02d}", "RGB", image)
    float32 = {f"variance.{letter}" for letter in "RGB"}
    write_exr(path, channels, _to_strings(bundle.meta, len(bundle.transport)), float32)


def read_bundle(path: Path | str) -> Bundle:
    """Read what ``write_bundle`` wrote.

    Raises:
        BadInput: if the file is missing, is no bundle, is of another version or lacks a channel.
    """
    channels, strings = read_exr(path)
    meta, count = _from_strings(Path(path), strings)
    try:
        vectors = {name: _stack(channels, name, letters) for name, letters in _VECTORS.items()}
        scalars = {name: channels[f"{name}.Y"] for name in _SCALARS}
        transport = np.stack([_stack(channels, f"transport.{k:02d}", "RGB") for k in range(count)])
    except KeyError as error:
        raise BadInput(f"{path}: channel {error} is missing; render the bundle again") from error
    try:
        return Bundle(**vectors, **scalars, transport=transport, meta=meta)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error


def _planes(name: str, letters: str, image: Array) -> dict[str, Array]:
    return {f"{name}.{letter}": image[..., i] for i, letter in enumerate(letters)}


def _stack(channels: dict[str, Array], name: str, letters: str) -> Array:
    return np.stack([channels[f"{name}.{letter}"] for letter in letters], axis=-1)


def _to_strings(meta: BundleMeta, count: int) -> dict[str, str]:
    values = {
        "version": VERSION,
        "transport": count,
        "seed": meta.seed,
        "face_model": meta.face_model,
        "spec_hash": meta.spec_hash,
        "light": meta.light.values.tolist(),
        "extra": meta.extra,
    }
    return {PREFIX + key: json.dumps(value, sort_keys=True) for key, value in values.items()}


def _from_strings(path: Path, strings: dict[str, str]) -> tuple[BundleMeta, int]:
    values = {
        key.removeprefix(PREFIX): json.loads(text) for key, text in strings.items() if key.startswith(PREFIX)
    }
    if "version" not in values:
        raise BadInput(
            f"{path}: an EXR without {PREFIX}version found, a bundle of `sfsnet-dr synth` expected"
        )
    if values["version"] != VERSION:
        raise BadInput(
            f"{path}: bundle of version {values['version']} found, {VERSION} expected; render again"
        )
    try:
        meta = BundleMeta(
            seed=values["seed"],
            face_model=values["face_model"],
            spec_hash=values["spec_hash"],
            light=Radiance(np.array(values["light"])),
            extra=values["extra"],
        )
        return meta, values["transport"]
    except KeyError as error:
        raise BadInput(f"{path}: metadata {PREFIX}{error.args[0]} is missing; render again") from error
