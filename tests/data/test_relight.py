"""Relighting and reflection, against a sphere whose shading is known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.spheres import sphere_bundle

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.relight import relight_bundle
from sfsnet_dr.data.transforms.camera import PhotoOptions
from sfsnet_dr.data.transforms.mirror import mirror_map, mirror_normal, mirror_transport, x_parity
from sfsnet_dr.render.transport_shading import (
    relight_batch,
    relight_responses,
    relight_transport,
    response_weights,
)
from sfsnet_dr.scene.lights.light import Light, direction_from_angles, rotation_about
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.coefficients import Radiance


def test_a_relit_sphere_is_albedo_times_shading() -> None:
    bundle = sphere_bundle(3)
    light = Radiance(np.random.default_rng(0).normal(size=(9, 3)))
    shading = light.to_shading().evaluate(bundle.normal.astype(np.float64))
    expected = bundle.albedo * shading
    # float32 storage of the transport, nine terms of size about one
    np.testing.assert_allclose(relight_transport(bundle.transport, light), expected, atol=2e-6)


def test_white_light_from_everywhere_shows_the_albedo() -> None:
    bundle = sphere_bundle(3)
    values = np.zeros((9, 3))
    values[0] = np.sqrt(4 * np.pi)  # radiance 1: Y_00 = 1 / sqrt(4 pi)
    np.testing.assert_allclose(
        relight_transport(bundle.transport, Radiance(values)), bundle.albedo, atol=1e-6
    )


def test_the_batch_form_agrees_face_by_face() -> None:
    bundles = [sphere_bundle(seed) for seed in range(3)]
    lights = [Radiance(np.random.default_rng(seed).normal(size=(9, 3))) for seed in range(3)]
    transport = torch.from_numpy(np.stack([np.moveaxis(b.transport, -1, 1) for b in bundles]))
    radiance = torch.from_numpy(np.stack([light.values for light in lights]))
    images = relight_batch(transport, radiance).numpy()
    for bundle, light, image in zip(bundles, lights, images, strict=True):
        expected = relight_transport(bundle.transport, light)
        np.testing.assert_allclose(np.moveaxis(image, 0, -1), expected, atol=2e-6)  # float32 sums
    assert images.dtype == np.float32


def test_shading_coefficients_are_refused() -> None:
    bundle = sphere_bundle(0)
    light = Radiance(np.ones((9, 3)))
    with pytest.raises(TypeError, match="Radiance is needed"):
        relight_transport(bundle.transport, light.to_shading())  # type: ignore[arg-type]
    with pytest.raises(InputError, match="K=4"):
        relight_transport(bundle.transport, light.truncate(1))
    with pytest.raises(InputError, match="radiance"):
        relight_batch(torch.zeros(2, 9, 3, 4, 4), torch.zeros(2, 3, 9))


@pytest.mark.parametrize("order", [0, 1, 2, 8])
def test_parity_is_that_of_the_basis(order: int) -> None:
    directions = np.random.default_rng(0).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    mirrored = sh_basis(directions * [-1, 1, 1], order)
    # float64 rounding of polynomials of degree 8
    np.testing.assert_allclose(mirrored, sh_basis(directions, order) * x_parity(order), atol=1e-12)


def test_the_reflected_face_under_the_reflected_light_is_the_reflected_picture() -> None:
    bundle = sphere_bundle(4)
    transport = torch.from_numpy(np.moveaxis(bundle.transport, -1, 1).copy())[None]
    light = torch.from_numpy(np.random.default_rng(0).normal(size=(1, 9, 3)))
    mirrored = light * torch.from_numpy(x_parity(2))[:, None]
    picture = relight_batch(transport, light)
    assert (picture - mirror_map(picture)).abs().max() > 0.1
    torch.testing.assert_close(
        relight_batch(mirror_transport(transport), mirrored), mirror_map(picture), atol=0, rtol=0
    )


def test_reflected_normals_shade_as_the_reflected_transport() -> None:
    bundle = sphere_bundle(4)
    light = Radiance(np.random.default_rng(0).normal(size=(9, 3)))
    normal = mirror_normal(torch.from_numpy(np.moveaxis(bundle.normal, -1, 0).copy())).numpy()
    albedo = bundle.albedo[:, ::-1]
    expected = albedo * light.to_shading().evaluate(np.moveaxis(normal, 0, -1).astype(np.float64))
    transport = mirror_transport(torch.from_numpy(np.moveaxis(bundle.transport, -1, 1).copy())).numpy()
    np.testing.assert_allclose(relight_transport(np.moveaxis(transport, 1, -1), light), expected, atol=2e-6)


def lit() -> Light:
    """A dim room, a lamp of the bundle's own and one from elsewhere."""
    room = np.full((64, 128, 3), 0.2)
    near = rotation_about(np.array([1.0, 0.0, 0.0]), 1.0) @ direction_from_angles(30.0, 0.0)
    return Light(
        "lit", room, ((near, np.array([3.0, 2, 1])), (direction_from_angles(-60.0, 10.0), np.ones(3)))
    )


def test_lamps_go_to_the_nearest_direction_or_into_the_coefficients() -> None:
    directions = np.stack(
        [
            direction_from_angles(35.0, 0.0),
            direction_from_angles(30.0, 0.0),
            direction_from_angles(-50.0, 10.0),
        ]
    )
    light = lit()
    mixed = response_weights(light, directions, 2)
    np.testing.assert_allclose(mixed.irradiance, [[0, 0, 0], [3, 2, 1], [0, 0, 0]])
    rest = Light("rest", light.environment, light.directional[1:])
    np.testing.assert_allclose(mixed.radiance, rest.coefficients(2).values, atol=1e-14)
    none = response_weights(light, np.zeros((0, 3)), 2)
    np.testing.assert_allclose(none.radiance, light.coefficients(2).values, atol=1e-14)
    assert none.irradiance.shape == (0, 3)


def test_a_scene_is_the_sum_of_its_responses() -> None:
    bundle, rng = sphere_bundle(1), np.random.default_rng(0)
    directions = np.stack([direction_from_angles(30.0, 0.0), direction_from_angles(-50.0, 10.0)])
    lamps = bundle.albedo * np.maximum(bundle.normal @ directions.T, 0).transpose(2, 0, 1)[..., None] / np.pi
    gloss = rng.uniform(size=(9, *bundle.mask.shape))
    mixed = response_weights(lit(), directions, 2)
    plain = relight_responses(bundle.transport, gloss[:0], lamps, mixed)
    # The lamp of the bundle is Lambert's law of the exact direction 1 degree away; the rest is order 2.
    toward, power = directions[0], np.array([3.0, 2, 1])
    hard = bundle.albedo * np.maximum(bundle.normal @ toward, 0)[..., None] * power / np.pi
    np.testing.assert_allclose(
        plain, hard + relight_transport(bundle.transport, Radiance(mixed.radiance)), atol=2e-6
    )
    shiny = relight_responses(bundle.transport, gloss, lamps, mixed)
    np.testing.assert_allclose(shiny - plain, np.einsum("khw,kc->hwc", gloss, mixed.radiance), atol=1e-12)

    def batch(*arrays: np.ndarray) -> list[torch.Tensor]:
        return [torch.from_numpy(np.array(a))[None] for a in arrays]

    transport, lamp_images = np.moveaxis(bundle.transport, -1, 1), np.moveaxis(lamps, -1, 1)
    inputs = batch(transport, mixed.radiance, gloss, lamp_images, mixed.irradiance)
    image = np.moveaxis(relight_batch(*inputs)[0].numpy(), 0, -1)
    np.testing.assert_allclose(image, shiny, atol=2e-5)  # float32 sums of up to 20


def test_one_call_relights_with_all_that_a_bundle_knows() -> None:
    bundle = sphere_bundle(1)
    gloss = np.random.default_rng(0).uniform(0, 0.1, (9, *bundle.mask.shape)).astype(np.float32)
    bundle = replace(bundle, gloss=gloss * bundle.coverage)
    room, power = np.full((64, 128, 3), 0.2), np.array([3.0, 2, 1])
    hard = Light("hard", room, ((bundle.directions[1], power),))
    image = relight_bundle(bundle, hard)
    toward = np.maximum(bundle.normal @ bundle.directions[1], 0)[..., None] * power / np.pi
    # The room is a light of order 0: the ball shows its albedo, and the first gloss response.
    expected = bundle.albedo * (0.2 + toward) + 0.2 * np.sqrt(4 * np.pi) * bundle.gloss[0][..., None]
    np.testing.assert_allclose(image, expected, atol=1e-4)  # the room's projection from a map
    elsewhere = Light("elsewhere", room, ((-bundle.directions[1], power),))
    soft = elsewhere.softened(bundle.directions)
    mixed = response_weights(soft, bundle.directions, 2)
    assert not mixed.irradiance.any()
    np.testing.assert_allclose(
        relight_bundle(bundle, elsewhere),
        relight_responses(bundle.transport, bundle.gloss, bundle.directional, mixed),
    )


def test_one_call_takes_a_photograph() -> None:
    bundle = sphere_bundle(1)
    light = Light("room", np.full((64, 128, 3), 0.5))
    photo = PhotoOptions(exposure=0.0, white_balance=0.0, blur=0.0, noise=0.0, jpeg=0.0, grayscale_prob=0.0)
    plain, taken = relight_bundle(bundle, light), relight_bundle(bundle, light, photo)
    covered = bundle.coverage == 1
    np.testing.assert_allclose(taken[covered], plain[covered], atol=1e-6)  # float32
    assert (taken[bundle.coverage == 0] > 0).any()
    first, again, other = (relight_bundle(bundle, light, PhotoOptions(), seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert first.shape == plain.shape
    assert 0 <= first.min() < first.max() <= 1


def test_responses_that_do_not_fit_are_refused() -> None:
    bundle = sphere_bundle(0)
    mixed = response_weights(lit(), np.zeros((0, 3)), 2)
    size = bundle.mask.shape
    with pytest.raises(InputError, match="gloss"):
        relight_responses(bundle.transport, np.zeros((4, *size)), np.zeros((0, *size, 3)), mixed)
    with pytest.raises(InputError, match="directional"):
        relight_responses(bundle.transport, np.zeros((9, *size)), np.zeros((2, *size, 3)), mixed)
    with pytest.raises(InputError, match="belong together"):
        relight_batch(
            torch.zeros(1, 9, 3, 4, 4), torch.zeros(1, 9, 3), directional=torch.zeros(1, 2, 3, 4, 4)
        )
