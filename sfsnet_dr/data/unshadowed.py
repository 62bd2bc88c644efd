"""A bundle as it would be if nothing shadowed anything: Lambert's law alone, in closed form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.core import provenance
from sfsnet_dr.data.bundle import Bundle, read_bundle, write_bundle
from sfsnet_dr.data.manifest import Entry, Manifest
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.kernel import band_of, clamped_cosine, order_of

#: Ends the hash of the specification that the bundles were rendered by.
_MARK: Final = "-no-visibility"


def without_visibility(bundle: Bundle) -> Bundle:
    """The same face without shadows and interreflection.

    ``transport_k`` becomes albedo A_l / pi Y_k(n), and the response to a lamp in direction d becomes
    albedo / pi max(0, n . d), both times the share of the pixel that is covered. ``gloss`` stays as it was
    rendered, for only light that is expanded in harmonics has a response of its own for it; a lamp's response
    holds both parts in one, so its highlight goes with its shadow. ``reference`` is still the path-traced
    image.
    """
    order = order_of(len(bundle.transport))
    normal = bundle.normal.astype(np.float64)
    matt = bundle.albedo.astype(np.float64) * bundle.coverage[..., None] / np.pi
    shading = sh_basis(normal, order) * clamped_cosine(order)[band_of(order)]
    cosines = np.maximum(np.einsum("hwc,dc->dhw", normal, bundle.directions), 0.0)
    return replace(
        bundle,
        transport=_responses(matt, np.moveaxis(shading, -1, 0)),
        directional=_responses(matt, cosines),
        meta=replace(bundle.meta, spec_hash=bundle.meta.spec_hash + _MARK),
    )


def remove_visibility(source: Path, folder: Path) -> None:
    """Write the bundles of a folder, without visibility, into another; those that are there stay.

    Raises:
        InputError: for a folder that holds something else.
    """
    rendered = Manifest(source)
    folder.mkdir(parents=True, exist_ok=True)
    made = Manifest(folder, f"{rendered.spec_hash}{_MARK}")
    finished = made.finished_seeds()
    for entry in rendered.entries:
        if entry.seed in finished:
            continue
        path = folder / entry.file
        write_bundle(path, without_visibility(read_bundle(source / entry.file)))
        digest = provenance.sha256(path)
        made.append(
            Entry(entry.file, entry.seed, entry.face_model, str(made.spec_hash), digest, entry.versions)
        )


def _responses(matt: NDArray[np.float64], shading: NDArray[np.float64]) -> NDArray[np.float32]:
    """(N, H, W, 3) of albedo (H, W, 3) and shadings (N, H, W)."""
    return np.asarray(matt * shading[..., None], np.float32)
