"""Transport times light: NumPy, torch and Dr.Jit give the same image, and ``Transport`` all that is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
import torch
from helpers.spheres import sphere_bundle

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.relight import relight_bundle
from sfsnet_dr.render.transport_shading import (
    DrjitTransport,
    ResponseWeights,
    Transport,
    relight_batch,
    relight_responses,
    relight_transport,
    response_weights,
)
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.sh.coefficients import Radiance

Array = npt.NDArray[np.float64]

RNG = np.random.default_rng(0)
TRANSPORT, GLOSS = RNG.normal(size=(25, 6, 5, 3)), RNG.normal(size=(9, 6, 5))
RADIANCE = RNG.normal(size=(25, 3))


def by_hand(terms: int) -> Array:
    """Pixel by pixel and colour by colour."""
    image = np.zeros((6, 5, 3))
    for i, j, c in np.ndindex(image.shape):
        image[i, j, c] = sum(TRANSPORT[k, i, j, c] * RADIANCE[k, c] for k in range(terms))
        image[i, j, c] += sum(GLOSS[k, i, j] * RADIANCE[k, c] for k in range(9))
    return image


@pytest.mark.parametrize("terms", [9, 25])
def test_three_backends_add_up_the_same(terms: int) -> None:
    expected = by_hand(terms)
    weights = ResponseWeights(RADIANCE[:terms], np.zeros((0, 3)))
    numpy = relight_responses(TRANSPORT[:terms], GLOSS, np.zeros((0, 6, 5, 3)), weights)
    np.testing.assert_allclose(numpy, expected, atol=1e-12)
    batch = relight_batch(
        torch.from_numpy(np.moveaxis(TRANSPORT[None, :terms], -1, 2)),
        torch.from_numpy(RADIANCE[None, :terms]),
        torch.from_numpy(GLOSS[None]),
    )
    largest = np.abs(expected).max()
    # 34 terms of single precision each: sqrt(34) x 6e-8 of the largest, times 5.
    np.testing.assert_allclose(np.moveaxis(batch[0].numpy(), 0, -1), expected, atol=2e-6 * largest)
    drjit = DrjitTransport(TRANSPORT, GLOSS).relight(RADIANCE[:terms])
    np.testing.assert_allclose(drjit, expected, atol=2e-6 * largest)


def test_torch_differentiates_by_the_light_and_the_transport() -> None:
    transport = torch.from_numpy(np.moveaxis(TRANSPORT[None, :9], -1, 2)).requires_grad_()
    radiance = torch.from_numpy(RADIANCE[None, :9]).requires_grad_()
    gradients = torch.autograd.grad(relight_batch(transport, radiance).sum(), [transport, radiance])
    np.testing.assert_allclose(gradients[1][0], TRANSPORT[:9].sum((1, 2)), atol=1e-5)
    expected = np.broadcast_to(RADIANCE[None, :9, :, None, None], gradients[0].shape)
    np.testing.assert_allclose(gradients[0], expected, atol=1e-6)


def test_a_transport_relights_as_its_bundle_does() -> None:
    bundle = sphere_bundle(0)
    toward = bundle.directions[0]
    light = Light("both", np.full((64, 128, 3), 0.2), ((toward, np.full(3, 2.0)),))
    transport = Transport.of(bundle)
    expected = relight_bundle(bundle, light)
    np.testing.assert_array_equal(transport.relight(light), expected)
    np.testing.assert_array_equal(relight_transport(transport, light), expected)
    moved = replace(light, directional=((-toward, np.full(3, 2.0)),))
    assert not np.allclose(transport.relight(moved), expected, atol=0.01)


def test_without_directions_lamps_go_into_the_coefficients() -> None:
    bundle = sphere_bundle(0)
    toward = bundle.directions[0]
    lamp = Light("lamp", None, ((toward, np.ones(3)),))
    weights = response_weights(lamp, np.zeros((0, 3)), 2)
    np.testing.assert_allclose(weights.radiance, lamp.coefficients(2).values)
    bare = Transport(bundle.transport, bundle.gloss, bundle.directional[:0], np.zeros((0, 3)))
    whole = Transport.of(bundle)
    assert not np.allclose(bare.relight(lamp), whole.relight(lamp), atol=0.01)


def test_shapes_that_do_not_fit_are_refused() -> None:
    bundle = sphere_bundle(0)
    with pytest.raises(InputError, match="directions"):
        Transport(bundle.transport, bundle.gloss, bundle.directional, bundle.directions[:1])
    with pytest.raises(InputError, match="gloss"):
        Transport(bundle.transport, bundle.gloss[:, :3], bundle.directional, bundle.directions)
    with pytest.raises(TypeError, match="Shading found, Radiance is needed"):
        relight_transport(bundle.transport, Radiance(np.ones((9, 3))).to_shading())  # type: ignore[arg-type]
