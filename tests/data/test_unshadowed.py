"""Faces without shadows: Lambert's law, against the integral that it is and against convex bodies."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.spheres import sphere_bundle, write_spheres

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.bundle import read_bundle
from sfsnet_dr.data.manifest import Manifest
from sfsnet_dr.data.unshadowed import remove_visibility, without_visibility
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.projection import equirect_directions, equirect_solid_angles


def test_a_convex_matt_body_stays_as_it_is() -> None:
    bundle = sphere_bundle(3)
    found = without_visibility(bundle)
    np.testing.assert_allclose(found.transport, bundle.transport, atol=1e-6)  # float32 of values up to 1
    np.testing.assert_allclose(found.directional, bundle.directional, atol=1e-6)


def test_shadows_and_bounces_go_and_the_rest_stays() -> None:
    bundle = sphere_bundle(3)
    shadow = np.linspace(0.2, 1.5, bundle.mask.shape[1], dtype=np.float32)[:, None]
    gloss = np.random.default_rng(0).normal(size=(9, *bundle.mask.shape)).astype(np.float32)
    spoilt = replace(
        bundle, transport=bundle.transport * shadow, directional=bundle.directional * shadow, gloss=gloss
    )
    found = without_visibility(spoilt)
    np.testing.assert_allclose(found.transport, bundle.transport, atol=1e-6)
    np.testing.assert_allclose(found.directional, bundle.directional, atol=1e-6)
    for name in ("normal", "albedo", "mask", "coverage", "regions", "gloss", "directions", "reference"):
        assert np.array_equal(getattr(found, name), getattr(spoilt, name)), name
    assert found.meta.spec_hash != spoilt.meta.spec_hash


def test_the_transport_is_the_integral_over_the_hemisphere_and_the_covered_share() -> None:
    bundle = sphere_bundle(5, size=8)
    half = replace(bundle, coverage=0.5 * bundle.coverage, transport=np.zeros((25, 8, 8, 3), np.float32))
    found = without_visibility(half)
    directions = equirect_directions(64, 128).reshape(-1, 3)
    weights = equirect_solid_angles(64, 128).reshape(-1)
    basis = sh_basis(directions, 4) * weights[:, None]
    row, column = np.argwhere(bundle.mask > 0)[7]
    cosines = np.maximum(directions @ bundle.normal[row, column].astype(np.float64), 0)
    expected = 0.5 * bundle.albedo[row, column] / np.pi * (cosines @ basis)[:, None]
    # the quadrature's error, 2e-4 of the largest value on this grid
    np.testing.assert_allclose(found.transport[:, row, column], expected, atol=5e-4)
    assert abs(expected).max() > 0.04


def test_a_folder_is_written_once_and_gone_on_with(tmp_path: Path) -> None:
    source, folder = write_spheres(tmp_path / "faces", 3), tmp_path / "matt"
    remove_visibility(source, folder)
    entries = Manifest(folder).entries
    assert [entry.seed for entry in entries] == [0, 1, 2]
    bundle = read_bundle(folder / entries[1].file)
    np.testing.assert_allclose(bundle.transport, sphere_bundle(1).transport, atol=1e-3)  # half floats
    (folder / entries[1].file).unlink()
    (folder / "manifest.jsonl").write_text("")
    remove_visibility(source, folder)
    again = Manifest(folder).entries
    assert [entry.sha256 for entry in again] == [entry.sha256 for entry in entries], "the same bytes again"
    assert hashlib.sha256((folder / entries[0].file).read_bytes()).hexdigest() == entries[0].sha256
    kept = (folder / entries[0].file).stat().st_mtime_ns
    remove_visibility(source, folder)
    assert (folder / entries[0].file).stat().st_mtime_ns == kept, "what is there is not written again"
    with pytest.raises(InputError, match="choose another folder"):
        remove_visibility(folder, source)
