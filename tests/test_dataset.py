"""Training batches: labels that explain their image, and the same sequence whoever asks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from spheres import sphere_bundle, write_spheres

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.data.augment import Augmentation, add_noise, backgrounds
from sfsnet_dr.data.bundle import write_bundle
from sfsnet_dr.data.dataset import Faces, RelitFaces, load_faces
from sfsnet_dr.sh.basis import sh_basis

PLAIN = Augmentation(flip=0.0, exposure=0.0, noise=0.0, clip=False)


@pytest.fixture(scope="module")
def faces(tmp_path_factory: pytest.TempPathFactory) -> Faces:
    """Five spheres from files."""
    return load_faces(write_spheres(tmp_path_factory.mktemp("faces"), 5))


@pytest.mark.parametrize("flip", [0.0, 1.0])
def test_the_labels_explain_the_image(faces: Faces, flip: float) -> None:
    augmentation = Augmentation(flip=flip, exposure=1.0, noise=0.0, clip=False)
    batch = RelitFaces(faces, 4, augmentation, seed=1).batch(3).check()
    normal = np.moveaxis(batch.normal.numpy().astype(np.float64), 1, -1)
    light = batch.light.numpy().reshape(4, 3, 9)
    shading = np.einsum("bhwk,bck->bchw", sh_basis(normal, 2), light)
    error = np.abs(batch.mask.numpy() * (batch.image.numpy() - batch.albedo.numpy() * shading))
    # halves of 11 bits in normal, albedo and nine terms of transport; worst seen 1.1e-3
    assert error.max() < 3e-3
    assert (batch.mask * batch.image).max() > 0.2


def test_a_batch_depends_on_seed_and_number_only(faces: Faces) -> None:
    augmentation = Augmentation()
    first = RelitFaces(faces, 4, augmentation, seed=1)
    later = first.batch(7)
    first.batch(2)
    again = RelitFaces(faces, 4, augmentation, seed=1).batch(7)
    assert all(torch.equal(a, b) for a, b in zip(later, again, strict=True))
    other_seed = RelitFaces(faces, 4, augmentation, seed=2).batch(7)
    assert not torch.equal(later.light, other_seed.light)
    assert not torch.equal(later.light, first.batch(8).light)


def test_every_face_is_seen_once_an_epoch(faces: Faces) -> None:
    relit = RelitFaces(faces, 3, PLAIN, seed=1)
    seen = [index for step in range(10) for index in relit.indices(step)]
    epochs = [seen[i : i + 5] for i in range(0, 30, 5)]
    assert all(sorted(epoch) == [0, 1, 2, 3, 4] for epoch in epochs)
    assert len({tuple(epoch) for epoch in epochs}) > 1


def test_reading_batches_leaves_the_faces_alone(faces: Faces) -> None:
    before = [t.clone() for t in (faces.normal, faces.albedo, faces.transport)]
    RelitFaces(faces, 5, Augmentation(flip=1.0), seed=1).batch(0)
    assert all(
        torch.equal(a, b) for a, b in zip(before, (faces.normal, faces.albedo, faces.transport), strict=True)
    )


def test_normals_are_unit_on_the_face(faces: Faces) -> None:
    batch = RelitFaces(faces, 5, PLAIN, seed=1).batch(0)
    length = batch.normal.norm(dim=1, keepdim=True)[batch.mask > 0]
    torch.testing.assert_close(length, torch.ones_like(length), atol=1e-6, rtol=0)


def test_background_fills_what_the_face_does_not_cover(faces: Faces) -> None:
    batch = RelitFaces(faces, 5, PLAIN, seed=1).batch(0)
    assert (batch.image[:, :1][batch.mask == 0] > 0).any()
    many = backgrounds(np.random.default_rng(0), 200, 8, 8)
    flat = (many - many[:, :, :1, :1]).abs().amax((1, 2, 3)) < 1e-5  # weights of interpolation round
    assert 70 < flat.sum() < 130  # half of 200, five standard deviations of 7 are 35
    assert many.min() >= 0
    assert many.max() <= 1


def test_noise_has_the_variance_it_says() -> None:
    image = torch.full((1, 3, 200, 200), 0.48)
    rng = np.random.default_rng(0)
    level = np.random.default_rng(0).uniform(0, 0.1, 1)[0]
    noise = add_noise(image, rng, 0.1) - image
    # 120,000 samples give the standard deviation to 1 / sqrt(240,000) = .2 %; five of these
    assert float(noise.std()) == pytest.approx(level * (0.48 + 0.02) ** 0.5, rel=0.01)
    assert abs(float(noise.mean())) < 5 * float(noise.std()) / 120_000**0.5


def test_exposure_changes_the_light_by_one_factor_an_image(faces: Faces) -> None:
    plain = RelitFaces(faces, 40, PLAIN, seed=1).batch(0).light
    varied = RelitFaces(faces, 40, replace(PLAIN, exposure=1.0), seed=1).batch(0).light
    stops = (varied / plain).log2().median(1, keepdim=True).values
    torch.testing.assert_close(varied, plain * 2**stops, rtol=1e-5, atol=1e-6)  # float32
    # 40 draws from -1 to 1: all within .7, or all on one side, has a chance of 1e-6 and less
    assert 0.7 < float(stops.abs().max()) <= 1
    assert float(stops.min()) < 0 < float(stops.max())


def test_clipping_keeps_what_a_screen_shows(faces: Faces) -> None:
    bright = Augmentation(exposure=3.0, noise=0.05, clip=True)
    batches = [RelitFaces(faces, 5, bright, seed=1).batch(k).image for k in range(3)]
    assert min(float(b.min()) for b in batches) >= 0
    assert max(float(b.max()) for b in batches) == 1


@pytest.mark.parametrize("values", [{"flip": 1.5}, {"exposure": -1.0}, {"noise": float("nan")}])
def test_impossible_augmentations_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(BadInput, match=next(iter(values))):
        Augmentation(**values)  # type: ignore[arg-type]


def test_folders_without_usable_faces_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no bundles listed"):
        load_faces(tmp_path)
    folder = write_spheres(tmp_path / "spheres", 2)
    write_bundle(folder / "sphere_001.exr", sphere_bundle(1, 20))
    with pytest.raises(BadInput, match=r"sphere_001\.exr: \(20, 20\) pixels found, \(16, 16\)"):
        load_faces(folder)
    empty = sphere_bundle(1)
    empty.mask[:] = 0
    write_bundle(folder / "sphere_001.exr", empty)
    with pytest.raises(BadInput, match=r"sphere_001\.exr: the mask is empty"):
        load_faces(folder)
    (folder / "sphere_001.exr").unlink()
    with pytest.raises(BadInput, match=r"sphere_001\.exr"):
        load_faces(folder)
