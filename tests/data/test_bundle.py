"""Bundle files: what comes back, at which precision, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.spheres import sphere_bundle

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.image_io import read_exr, write_exr
from sfsnet_dr.data.bundle import PREFIX, read_bundle, write_bundle


def test_a_bundle_comes_back_at_half_precision(tmp_path: Path) -> None:
    written = sphere_bundle(5)
    write_bundle(tmp_path / "b.exr", written)
    read = read_bundle(tmp_path / "b.exr")
    for name in ("normal", "albedo", "mask", "coverage", "reference", "transport", "gloss", "directional"):
        a, b = getattr(written, name), getattr(read, name)
        # a half has 11 significant bits, and steps of 6e-8 near zero
        np.testing.assert_allclose(b, a, rtol=2**-11, atol=6e-8, err_msg=name)
        assert b.dtype == np.float32
    np.testing.assert_array_equal(read.variance, written.variance)
    np.testing.assert_array_equal(read.regions, written.regions)
    assert read.regions.dtype == np.uint8
    np.testing.assert_array_equal(read.directions, written.directions)
    np.testing.assert_array_equal(read.meta.light.values, written.meta.light.values)
    assert replace(read.meta, light=written.meta.light) == written.meta


def test_channels_have_the_documented_names(tmp_path: Path) -> None:
    bundle = sphere_bundle(5)
    write_bundle(tmp_path / "b.exr", bundle)
    channels, strings = read_exr(tmp_path / "b.exr")
    expected = {f"normal.{c}" for c in "XYZ"} | {"mask.Y", "coverage.Y", "regions.Y"}
    expected |= {f"{name}.{c}" for name in ("albedo", "reference", "variance") for c in "RGB"}
    expected |= {f"transport.{k:02d}.{c}" for k in range(9) for c in "RGB"}
    expected |= {f"directional.{k:02d}.{c}" for k in range(2) for c in "RGB"}
    assert set(channels) == expected
    np.testing.assert_array_equal(
        channels["transport.04.G"], bundle.transport[4, ..., 1].astype(np.float16)
    )  # not shifted, not in another colour
    assert strings[f"{PREFIX}seed"] == "5"


def test_a_glossy_bundle_of_order_4_comes_back(tmp_path: Path) -> None:
    plain = sphere_bundle(3)
    rng = np.random.default_rng(0)
    gloss = rng.normal(size=(9, *plain.mask.shape)).astype(np.float16).astype(np.float32)
    transport = rng.normal(size=(25, *plain.mask.shape, 3)).astype(np.float16).astype(np.float32)
    no_lamps = replace(plain, directional=plain.directional[:0], directions=plain.directions[:0])
    written = replace(no_lamps, gloss=gloss, transport=transport)
    write_bundle(tmp_path / "b.exr", written)
    read = read_bundle(tmp_path / "b.exr")
    np.testing.assert_array_equal(read.gloss, gloss)
    np.testing.assert_array_equal(read.transport, transport)
    assert read.directional.shape == (0, 16, 16, 3)
    assert read.directions.shape == (0, 3)


def test_the_same_bundle_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.exr", "b.exr"):
        write_bundle(tmp_path / name, sphere_bundle(2))
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_wrong_shapes_and_values_are_refused() -> None:
    bundle = sphere_bundle(1)
    with pytest.raises(InputError, match="mask: shape"):
        replace(bundle, mask=bundle.mask[:-1])
    with pytest.raises(InputError, match="8 found"):
        replace(bundle, transport=bundle.transport[:8])
    with pytest.raises(InputError, match="gloss: 4 responses found, 0 or 9"):
        replace(bundle, gloss=np.zeros((4, *bundle.mask.shape), np.float32))
    with pytest.raises(InputError, match="directional: shape"):
        replace(bundle, directional=bundle.directional[..., :2])
    with pytest.raises(InputError, match="directions: shape"):
        replace(bundle, directions=bundle.directions[:1])
    with pytest.raises(InputError, match="directions: lengths 2 to 2 found"):
        replace(bundle, directions=2 * bundle.directions)
    spoilt = bundle.albedo.copy()
    spoilt[3, 3, 1] = np.nan
    with pytest.raises(InputError, match="albedo: NaN"):
        replace(bundle, albedo=spoilt)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "b.exr"
    write_exr(path, {"R": np.zeros((4, 4))}, {})
    with pytest.raises(InputError, match=rf"b\.exr: an EXR without {PREFIX}version"):
        read_bundle(path)

    write_bundle(path, sphere_bundle(1))
    channels, strings = read_exr(path)
    write_exr(path, channels, strings | {f"{PREFIX}version": "7"})
    with pytest.raises(InputError, match=r"b\.exr: bundle of version 7 found, 3 expected"):
        read_bundle(path)
    write_exr(path, channels, {k: v for k, v in strings.items() if k != f"{PREFIX}light"})
    with pytest.raises(InputError, match=rf"metadata {PREFIX}light is missing"):
        read_bundle(path)
    del channels["transport.07.G"]
    write_exr(path, channels, strings)
    with pytest.raises(InputError, match=r"channel 'transport\.07\.G' is missing"):
        read_bundle(path)
