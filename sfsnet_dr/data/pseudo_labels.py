"""What a network said about photographs, kept in few bytes as labels for another network.

A folder holds ``labels.json`` (what the labels were made with), shards ``labels-00000.safetensors`` of up to
256 photographs, and, once all are there, ``manifest.json`` with the shards' hashes and the photographs that
were skipped or held back. A shard has, for each photograph:

``image``: the picture, sRGB-encoded, (N, 3, S, S) uint8. ``mask``, ``confidence``: (N, 1, S, S) in 255ths,
uint8. ``normal``: unit vectors in 127ths, (N, 3, S, S) int8, which rounds by 0.4 degrees at most. ``albedo``:
clamped to [0, 1] and sRGB-encoded, (N, 3, S, S) uint8. ``light``: shading coefficients, (N, 27) float32.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from sfsnet_dr.core.color_torch import linear_to_srgb, srgb_to_linear
from sfsnet_dr.core.conventions import LIGHT_SIZE
from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.core.files import atomic_path, write_text
from sfsnet_dr.core.provenance import sha256

FORMAT: Final = "sfsnet_dr.pseudo_labels.1"
SPEC: Final = "labels.json"
MANIFEST: Final = "manifest.json"
SHARD: Final = 256

#: What a photograph's numbers are to a network: linear light, or the encoded values themselves. The latter is
#: the paper's form, in which albedo times shading is to equal what the file holds.
Encoding = Literal["linear", "srgb"]


class Labels(NamedTuple):
    """Labels as they are kept; the fields are those of a shard."""

    image: Tensor
    mask: Tensor
    confidence: Tensor
    normal: Tensor
    albedo: Tensor
    light: Tensor


@dataclass(frozen=True, eq=False)
class PseudoFaces:
    """N photographs with their labels in memory, as kept; ``decode_labels`` gives numbers to compute with.

    Attributes:
        labels: all shards, joined.
        names: N photographs.
        spec: what they were made with, ``labels.json``.
        fingerprint: of all shards.
    """

    labels: Labels
    names: tuple[str, ...]
    spec: Mapping[str, Any]
    fingerprint: str

    def __len__(self) -> int:
        return len(self.names)

    def to(self, device: torch.device | str) -> PseudoFaces:
        """The same in another device's memory."""
        labels = Labels(*(tensor.to(device) for tensor in self.labels))
        return PseudoFaces(labels, self.names, self.spec, self.fingerprint)


def encode_labels(
    image: Tensor, mask: Tensor, confidence: Tensor, normal: Tensor, albedo: Tensor, light: Tensor
) -> Labels:
    """Labels as kept, of a picture and a mask that are bytes already, and numbers for the rest."""
    return Labels(
        image,
        mask,
        _bytes(confidence),
        (normal * 127).round().clamp(-127, 127).to(torch.int8),
        _bytes(linear_to_srgb(albedo.clamp(0, 1))),
        light.float(),
    )


def decode_labels(labels: Labels) -> Labels:
    """Float32 numbers: ``image`` still sRGB-encoded, all in [0, 1], albedo linear, normals of length 1."""
    normal = labels.normal.float()
    return Labels(
        labels.image.float() / 255,
        labels.mask.float() / 255,
        labels.confidence.float() / 255,
        normal / normal.square().sum(1, keepdim=True).sqrt().clamp_min(1e-6),
        srgb_to_linear(labels.albedo.float() / 255),
        labels.light,
    )


def as_network_input(images: Tensor, values: Encoding) -> Tensor:
    """Photographs (N, 3, S, S) uint8 as float32: decoded to linear light, or as they are."""
    shown = images.float() / 255
    return srgb_to_linear(shown) if values == "linear" else shown


class LabelFolder:
    """A folder that labels are written to, shard by shard, each whole or absent.

    Args:
        folder: exists already.
        spec: all that decides the labels, JSON values.

    Raises:
        InputError: if the folder holds labels of another specification, naming what differs.
    """

    def __init__(self, folder: Path, spec: Mapping[str, Any]) -> None:
        self.folder, self.spec = folder, {"format": FORMAT, **spec}
        path = folder / SPEC
        if path.exists():
            _check_spec(path, _read_json(path), self.spec)
        else:
            write_text(path, json.dumps(self.spec, indent=1, sort_keys=True) + "\n")

    def has(self, number: int) -> bool:
        """Whether a shard is there."""
        return self._path(number).is_file()

    def write(
        self,
        number: int,
        labels: Labels,
        names: Sequence[str],
        hashes: Sequence[str],
        skipped: Mapping[str, str],
    ) -> None:
        """Write a shard with its photographs' names and file hashes, and why others are not in it."""
        header = {"names": list(names), "sha256": list(hashes), "skipped": dict(skipped)}
        tensors = {name: tensor.contiguous() for name, tensor in labels._asdict().items()}
        with atomic_path(self._path(number)) as partial:
            save_file(tensors, partial, {"sfsnet_dr": json.dumps(header, sort_keys=True)})

    def finish(self, count: int, held_back: Sequence[str], skipped: Mapping[str, str]) -> dict[str, Any]:
        """Write and give the manifest of ``count`` shards.

        Args:
            count: shards; all are there.
            held_back: photographs kept for measuring.
            skipped: photographs that are in no shard, with the reason; those that shards tell are added.
        """
        headers = [_header(self._path(number)) for number in range(count)]
        manifest = {
            "format": FORMAT,
            "shards": {self._path(number).name: sha256(self._path(number)) for number in range(count)},
            "labelled": sum(len(header["names"]) for header in headers),
            "held_back": list(held_back),
            "skipped": dict(skipped) | {n: r for header in headers for n, r in header["skipped"].items()},
        }
        write_text(self.folder / MANIFEST, json.dumps(manifest, indent=1, sort_keys=True) + "\n")
        return manifest

    def _path(self, number: int) -> Path:
        return self.folder / f"labels-{number:05d}.safetensors"


def load_pseudo_labels(folder: Path | str) -> PseudoFaces:
    """Read all labels of a finished folder, checking every shard's hash.

    Raises:
        InputError: if the folder is missing, unfinished, of another version, empty or damaged.
    """
    folder = Path(folder)
    if not (folder / MANIFEST).is_file():
        raise InputError(
            f"{folder}: no finished labels ({MANIFEST}); run `sfsnet-dr pseudo-label` to its end"
        )
    manifest, spec = _read_json(folder / MANIFEST), _read_json(folder / SPEC)
    for found in (manifest, spec):
        if found.get("format") != FORMAT:
            raise InputError(f"{folder}: labels of format {found.get('format')!r} found, {FORMAT} expected")
    if not manifest["shards"]:
        raise InputError(
            f"{folder}: no labels in it; give photographs with faces to `sfsnet-dr pseudo-label`"
        )
    parts, names = [], []
    for file, digest in sorted(manifest["shards"].items()):
        labels, own = _read_shard(folder / file, digest)
        parts.append(labels)
        names += own
    joined = Labels(*(torch.cat(tensors) for tensors in zip(*parts, strict=True)))
    fingerprint = hashlib.sha256("".join(sorted(manifest["shards"].values())).encode()).hexdigest()
    return PseudoFaces(joined, tuple(names), spec, fingerprint)


def _read_shard(path: Path, digest: str) -> tuple[Labels, list[str]]:
    if not path.is_file() or sha256(path) != digest:
        raise InputError(
            f"{path}: missing or changed since it was written; run `sfsnet-dr pseudo-label` again"
        )
    try:
        tensors = load_file(path)
        labels = Labels(**tensors)
        header = _header(path)
    except (SafetensorError, TypeError, KeyError, ValueError) as error:
        raise InputError(f"{path}: no shard of labels ({' '.join(str(error).split())})") from error
    sizes = check_shape(f"{path}: image", labels.image, "N 3 S S", N=len(header["names"]))
    check_shape(f"{path}: light", labels.light, f"N {LIGHT_SIZE}", N=sizes["N"])
    return labels, header["names"]


def _header(path: Path) -> dict[str, Any]:
    with safe_open(path, framework="pt") as file:
        header: dict[str, Any] = json.loads(file.metadata()["sfsnet_dr"])
    return header


def _check_spec(path: Path, found: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    for key in sorted(found.keys() | wanted.keys()):
        if found.get(key) != wanted.get(key):
            raise InputError(
                f"{path}: labels with {key} = {found.get(key)!r} found, {wanted.get(key)!r} asked for; "
                "choose another folder"
            )


def _read_json(path: Path) -> dict[str, Any]:
    try:
        values: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from error
    return values


def _bytes(values: Tensor) -> Tensor:
    return (values.clamp(0, 1) * 255).round().to(torch.uint8)
