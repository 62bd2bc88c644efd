"""One rendered face with its ground truth and light transport, as one EXR file."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.core.image_io import read_exr, write_exr
from sfsnet_dr.sh.coefficients import Radiance
from sfsnet_dr.sh.kernel import order_of

Array = NDArray[np.float32]

#: Version of the layout below; a file of another version is refused.
VERSION: Final = 3

#: Name of the directional responses by version; files of both are read.
_DIRECTIONAL: Final = {2: "lamps", 3: "directional"}

#: Responses of the glossy part, of order 2.
_GLOSS: Final = 9

#: Prefix of every metadata key.
PREFIX: Final = "sfsnet_dr:"

_VECTORS: Final = {"normal": "XYZ", "albedo": "RGB", "reference": "RGB", "variance": "RGB"}
_SCALARS: Final = ("mask", "coverage", "regions")
_FLOATS: Final = (*_VECTORS, "mask", "coverage", "transport", "gloss", "directional", "directions")


@dataclass(frozen=True)
class BundleMeta:
    """What a bundle's numbers belong to.

    Args:
        seed: the seed that, with the spec, gives this face again.
        face_model: name of the face model.
        spec_hash: hash of the specification that the whole dataset shares.
        light: radiance coefficients of the light of ``reference`` (K, 3).
        extra: anything JSON can hold: samples per pixel, pose, versions.
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
        regions: label of ``scene.mesh.Region`` that most of the pixel shows, or ``NO_REGION``, (H, W) uint8.
        reference: path-traced image under ``meta.light``, (H, W, 3).
        variance: variance of the mean ``reference``, (H, W, 3).
        transport: linear image that the light of radiance Y_k alone gives, albedo, visibility and
            interreflection included, but without that light's mirror image in the surface's gloss,
            (K, H, W, 3); may be negative, for a basis function is.
        gloss: that mirror image, the same in every colour, (9, H, W); (0, H, W) for a diffuse surface.
        lamps: linear image that a directional light of irradiance 1 on a surface facing it gives, gloss and
            hard shadows included, (D, H, W, 3); D may be 0.
        directions: unit vectors toward these lights, (D, 3).
        meta: what the numbers belong to.

    Raises:
        InputError: if a shape does not fit the others, a value is NaN or infinite, or a direction has another
            length than 1.
    """

    normal: Array
    albedo: Array
    mask: Array
    coverage: Array
    regions: NDArray[np.uint8]
    reference: Array
    variance: Array
    transport: Array
    gloss: Array
    directional: Array
    directions: NDArray[np.float64]
    meta: BundleMeta

    def __post_init__(self) -> None:
        sizes = check_shape("normal", self.normal, "H W 3")
        for name in ("albedo", "reference", "variance"):
            check_shape(name, getattr(self, name), "H W 3", **sizes)
        for name in _SCALARS:
            check_shape(name, getattr(self, name), "H W", **sizes)
        order_of(check_shape("transport", self.transport, "K H W 3", **sizes)["K"])
        if check_shape("gloss", self.gloss, "G H W", **sizes)["G"] not in (0, _GLOSS):
            raise InputError(f"gloss: {len(self.gloss)} responses found, 0 or {_GLOSS} allowed")
        count = check_shape("directional", self.directional, "D H W 3", **sizes)["D"]
        check_shape("directions", self.directions, "D 3", D=count)
        for name in _FLOATS:
            if not np.isfinite(getattr(self, name)).all():
                raise InputError(f"{name}: NaN or inf found, finite values are needed")
        lengths = np.linalg.norm(self.directions, axis=1)
        if np.any(np.abs(lengths - 1.0) > 1e-6):
            raise InputError(f"directions: lengths {lengths.min():g} to {lengths.max():g} found, 1 allowed")


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
    for k, image in enumerate(bundle.gloss):
        channels[f"gloss.{k:02d}.Y"] = image
    for k, image in enumerate(bundle.directional):
        channels |= _planes(f"directional.{k:02d}", "RGB", image)
    float32 = {f"variance.{letter}" for letter in "RGB"}
    write_exr(path, channels, _to_strings(bundle), float32)


def read_bundle(path: Path | str) -> Bundle:
    """Read what ``write_bundle`` wrote.

    Raises:
        InputError: if the file is missing, is no bundle, is of another version or lacks a channel.
    """
    channels, strings = read_exr(path)
    values = _from_strings(Path(path), strings)
    try:
        meta = _meta(values)
        directions = np.array(values["directions"], dtype=np.float64).reshape(-1, 3)
        counts = {name: int(values[name]) for name in ("transport", "gloss")}
    except KeyError as error:
        raise InputError(f"{path}: metadata {PREFIX}{error.args[0]} is missing; render again") from error
    try:
        arrays = _arrays(
            channels, counts["transport"], counts["gloss"], len(directions), _DIRECTIONAL[values["version"]]
        )
    except KeyError as error:
        raise InputError(f"{path}: channel {error} is missing; render the bundle again") from error
    try:
        return Bundle(**arrays, directions=directions, meta=meta)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _arrays(
    channels: dict[str, Array], transport: int, gloss: int, directional: int, channel: str
) -> dict[str, Any]:
    arrays: dict[str, Any] = {name: _stack(channels, name, letters) for name, letters in _VECTORS.items()}
    arrays |= {name: channels[f"{name}.Y"] for name in _SCALARS}
    arrays["regions"] = arrays["regions"].astype(np.uint8)
    height, width = arrays["mask"].shape
    colours = {"transport": (transport, "transport"), "directional": (directional, channel)}
    for name, (count, prefix) in colours.items():
        images = [_stack(channels, f"{prefix}.{k:02d}", "RGB") for k in range(count)]
        arrays[name] = np.array(images, dtype=np.float32).reshape(count, height, width, 3)
    planes = [channels[f"gloss.{k:02d}.Y"] for k in range(gloss)]
    arrays["gloss"] = np.array(planes, dtype=np.float32).reshape(gloss, height, width)
    return arrays


def _planes(name: str, letters: str, image: Array) -> dict[str, Array]:
    return {f"{name}.{letter}": image[..., i] for i, letter in enumerate(letters)}


def _stack(channels: dict[str, Array], name: str, letters: str) -> Array:
    return np.stack([channels[f"{name}.{letter}"] for letter in letters], axis=-1)


def _to_strings(bundle: Bundle) -> dict[str, str]:
    meta = bundle.meta
    values = {
        "version": VERSION,
        "transport": len(bundle.transport),
        "gloss": len(bundle.gloss),
        "directions": bundle.directions.tolist(),
        "seed": meta.seed,
        "face_model": meta.face_model,
        "spec_hash": meta.spec_hash,
        "light": meta.light.values.tolist(),
        "extra": meta.extra,
    }
    return {PREFIX + key: json.dumps(value, sort_keys=True) for key, value in values.items()}


def _from_strings(path: Path, strings: dict[str, str]) -> dict[str, Any]:
    values = {
        key.removeprefix(PREFIX): json.loads(text) for key, text in strings.items() if key.startswith(PREFIX)
    }
    if "version" not in values:
        raise InputError(
            f"{path}: an EXR without {PREFIX}version found, a bundle of `sfsnet-dr synth` expected"
        )
    if values["version"] not in _DIRECTIONAL:
        raise InputError(
            f"{path}: bundle of version {values['version']} found, {VERSION} expected; render again"
        )
    return values


def _meta(values: dict[str, Any]) -> BundleMeta:
    return BundleMeta(
        seed=values["seed"],
        face_model=values["face_model"],
        spec_hash=values["spec_hash"],
        light=Radiance(np.array(values["light"])),
        extra=values["extra"],
    )
