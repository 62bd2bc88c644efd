"""Training batches: labels that explain their image, and the same sequence whoever asks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.spheres import SPEC, sphere_bundle, write_spheres

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.bundle import write_bundle
from sfsnet_dr.data.dataset import Faces, RelitFaces, load_faces
from sfsnet_dr.data.manifest import Entry, Manifest
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.data.transforms.camera import PhotoOptions
from sfsnet_dr.data.transforms.crop import Crop
from sfsnet_dr.data.transforms.mirror import mirror_map, mirror_normal, mirror_transport
from sfsnet_dr.render.transport_shading import relight_responses, response_weights
from sfsnet_dr.scene.lights.cache import light_cache_of
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.lights.spec import LightSpec
from sfsnet_dr.sh.basis import sh_basis

NO_PHOTO = PhotoOptions(0, 0, 0, 0, jpeg=0, grayscale_prob=0)
NO_LIGHT = LightSpec(hdr=0, sun_sky=0, studio=0, directional=0, ambient=0)
#: Soft lights, so dim that nothing clips; only the light varies.
PLAIN = Augmentation(
    flip=0.0, num_lights=12, light=replace(NO_LIGHT, lobes=1, exposure=(0.1, 0.2)), photo=NO_PHOTO
)
#: Everything that is quick to draw.
RICH = Augmentation(num_lights=12, light=replace(NO_LIGHT, lobes=1, directional=1))


@pytest.fixture(scope="module")
def faces(tmp_path_factory: pytest.TempPathFactory) -> Faces:
    """Five spheres from files."""
    return load_faces(write_spheres(tmp_path_factory.mktemp("faces"), 5))


@pytest.mark.parametrize("flip", [0.0, 1.0])
def test_the_labels_explain_the_image(faces: Faces, flip: float) -> None:
    gain = PhotoOptions(exposure=1.0, white_balance=0.3, blur=0, noise=0, jpeg=0, grayscale_prob=0)
    batch = RelitFaces(faces, 4, replace(PLAIN, flip=flip, photo=gain), seed=1).batch(3).check()
    normal = np.moveaxis(batch.normal.numpy().astype(np.float64), 1, -1)
    light = batch.light.numpy().reshape(4, 3, 9)
    shading = np.einsum("bhwk,bck->bchw", sh_basis(normal, 2), light)
    error = np.abs(batch.mask.numpy() * (batch.image.numpy() - batch.albedo.numpy() * shading))
    # halves of 11 bits in normal, albedo and nine terms of transport; worst seen 3.4e-4 of images up to 0.3
    assert error.max() < 1e-3
    assert (batch.mask * batch.image).max() > 0.1


def test_hard_lamps_and_gloss_are_those_of_the_bundle(tmp_path: Path) -> None:
    bundle = sphere_bundle(0)
    gloss = np.random.default_rng(0).uniform(0, 0.1, (9, 16, 16)).astype(np.float32) * bundle.coverage
    bundle = replace(
        bundle, gloss=gloss, directional=bundle.directional[:1], directions=bundle.directions[:1]
    )
    write_bundle(tmp_path / "a.exr", bundle)
    Manifest(tmp_path, SPEC).append(Entry("a.exr", 0, "sphere", SPEC, "0"))
    dome = np.full((64, 128, 3), 0.3)
    lamp = Light("lamp", dome, ((bundle.directions[0], np.array([1.0, 2.0, 0.5])),))
    light = replace(NO_LIGHT, lobes=1, exposure=(0.3, 0.3), white_balance=(1.0, 1.0))
    augmentation = replace(PLAIN, light=light)
    batch = RelitFaces(load_faces(tmp_path), 1, augmentation, 0, light_cache_of([(lamp, False)])).batch(0)
    taken = lamp.balanced(1.0).exposed(0.3)
    mixed = response_weights(taken, bundle.directions, 2)
    expected = relight_responses(bundle.transport, bundle.gloss, bundle.directional, mixed)
    inside = bundle.coverage[..., None] > 0
    found = np.moveaxis(batch.image[0].numpy(), 0, -1)
    np.testing.assert_allclose(found * inside, expected * inside, atol=1e-3)  # halves
    assert (expected * inside).max() > 0.2
    np.testing.assert_allclose(batch.light[0].numpy(), taken.shading_label().flat(), atol=1e-5)


def mirrored(faces: Faces) -> Faces:
    """Faces and their responses, reflected one by one."""
    return replace(
        faces,
        normal=mirror_normal(faces.normal),
        albedo=mirror_map(faces.albedo),
        mask=mirror_map(faces.mask),
        coverage=mirror_map(faces.coverage),
        transport=mirror_transport(faces.transport),
        directional=mirror_map(faces.directional),
        directions=faces.directions * [-1.0, 1.0, 1.0],
    )


def test_a_flipped_batch_is_that_of_the_mirrored_faces(faces: Faces) -> None:
    flipped = RelitFaces(faces, 5, replace(RICH, flip=1.0), seed=4).batch(2)
    again = RelitFaces(mirrored(faces), 5, replace(RICH, flip=0.0), seed=4).batch(2)
    for name, a, b in zip(FaceBatch._fields, flipped, again, strict=True):
        torch.testing.assert_close(a, b, atol=1e-6, rtol=0, msg=name)


def test_grey_pictures_have_grey_answers(faces: Faces) -> None:
    grey = PhotoOptions(0, 0, 0, 0, jpeg=0, grayscale_prob=1.0)
    batch = RelitFaces(faces, 3, replace(PLAIN, photo=grey), seed=1).batch(0)
    colourful = RelitFaces(faces, 3, PLAIN, seed=1).batch(0)
    for values in (batch.image, batch.albedo, batch.light.reshape(3, 3, 9)):
        torch.testing.assert_close(values, values[:, :1].expand_as(values))
    torch.testing.assert_close(batch.normal, colourful.normal)
    weights = torch.tensor(LUMINANCE, dtype=torch.float32)[:, None, None]
    torch.testing.assert_close(batch.albedo[:, 0], (colourful.albedo * weights).sum(1))


def test_smaller_faces_are_means_of_larger_ones(tmp_path: Path) -> None:
    folder = write_spheres(tmp_path / "spheres", 2)
    whole, half = load_faces(folder), load_faces(folder, Crop(8))
    assert half.transport.shape == (2, 9, 3, 8, 8)
    assert half.fingerprint != whole.fingerprint
    expected = whole.directional.float().reshape(2, 2, 3, 8, 2, 8, 2).mean((4, 6))
    torch.testing.assert_close(half.directional.float(), expected, atol=1e-3, rtol=0)
    batch = RelitFaces(half, 2, PLAIN, seed=1).batch(0)
    length = batch.normal.norm(dim=1, keepdim=True)[batch.mask == 1]
    torch.testing.assert_close(length, torch.ones_like(length), atol=1e-6, rtol=0)
    with pytest.raises(InputError, match=r"16 x 16 pixels found, a square of 20 .*; see data\.size"):
        load_faces(folder, Crop(20))


def test_a_batch_depends_on_seed_and_number_only(faces: Faces) -> None:
    augmentation = RICH
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
    RelitFaces(faces, 5, replace(RICH, flip=1.0), seed=1).batch(0)
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


def test_the_cameras_gain_is_in_the_light(faces: Faces) -> None:
    plain = RelitFaces(faces, 40, PLAIN, seed=1).batch(0).light.reshape(40, 3, 9)
    gain = PhotoOptions(exposure=1.0, white_balance=0.2, blur=0, noise=0, jpeg=0, grayscale_prob=0)
    varied = RelitFaces(faces, 40, replace(PLAIN, photo=gain), seed=1).batch(0).light.reshape(40, 3, 9)
    stops = (varied / plain).log2().median(2, keepdim=True).values
    torch.testing.assert_close(varied, plain * 2**stops, rtol=1e-5, atol=1e-6)  # float32
    # Green has exposure alone. 40 draws from -1 to 1: all within 0.7 or on one side has a chance of 1e-6.
    assert 0.7 < float(stops[:, 1].abs().max()) <= 1
    assert float(stops[:, 1].min()) < 0 < float(stops[:, 1].max())
    assert float((stops[:, 0] - stops[:, 1]).abs().max()) > 0.2


def test_pictures_are_what_a_screen_shows(faces: Faces) -> None:
    light = replace(RICH.light, exposure=(2.0, 4.0))
    batches = [RelitFaces(faces, 5, replace(RICH, light=light), seed=1).batch(k).image for k in range(3)]
    assert min(float(b.min()) for b in batches) >= 0
    assert max(float(b.max()) for b in batches) == 1


def test_folders_without_usable_faces_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no bundles listed"):
        load_faces(tmp_path)
    folder = write_spheres(tmp_path / "spheres", 2)
    write_bundle(folder / "sphere_001.exr", sphere_bundle(1, 20))
    with pytest.raises(InputError, match=r"sphere_001\.exr: \(20, 20\) pixels found, \(16, 16\)"):
        load_faces(folder)
    empty = sphere_bundle(1)
    empty.mask[:] = 0
    write_bundle(folder / "sphere_001.exr", empty)
    with pytest.raises(InputError, match=r"sphere_001\.exr: the mask is empty"):
        load_faces(folder)
    (folder / "sphere_001.exr").unlink()
    with pytest.raises(InputError, match=r"sphere_001\.exr"):
        load_faces(folder)
