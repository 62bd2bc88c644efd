"""The three forms of f_render: closed forms and SciPy first, then each other, then bad input."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from scipy.special import sph_harm_y

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.render import shading_drjit, shading_numpy, shading_torch
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.coefficients import Radiance

Array = npt.NDArray[np.float64]
Form = Callable[..., Array]


def _from_torch(function: Callable[..., torch.Tensor]) -> Form:
    def call(*arrays: npt.ArrayLike) -> Array:
        # A copy: Dr.Jit and torch share memory with what they are given.
        tensors = [torch.from_numpy(np.array(a, dtype=np.float32)) for a in arrays]
        return np.asarray(function(*tensors).numpy(), dtype=np.float64)

    return call


#: Form, its highest order, and its tolerance for values up to about 6. Worst of ten scenes: 2e-14 for NumPy
#: and 1.3e-6 for float32; margin 4 and more.
FORMS = {
    "numpy": (shading_numpy.f_render, 8, 1e-13),
    "torch": (_from_torch(shading_torch.f_render), 4, 5e-6),
    "drjit": (_from_torch(shading_drjit.f_render), 4, 5e-6),
}
SHADINGS = {
    "numpy": shading_numpy.shading,
    "torch": _from_torch(shading_torch.shading),
    "drjit": _from_torch(shading_drjit.shading),
}


def _scene(batch: int, order: int, seed: int = 0) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal((batch, 3, 7, 5))
    return normal, rng.uniform(size=(batch, 3, 7, 5)), rng.standard_normal((batch, 3 * (order + 1) ** 2))


def _scipy_render(normal: Array, albedo: Array, light: Array, order: int) -> Array:
    """f_render from SciPy's complex harmonics alone."""
    x, y, z = np.moveaxis(normal / np.linalg.norm(normal, axis=1, keepdims=True), 1, 0)
    theta, phi = np.arccos(z), np.arctan2(y, x)
    image = np.zeros_like(albedo)
    for c in range(3):
        k = c * (order + 1) ** 2
        for band in range(order + 1):
            for m in range(band + 1):
                value = (-1.0) ** m * sph_harm_y(band, m, theta, phi) * (np.sqrt(2) if m else 1)
                for part in [value.real] if m == 0 else [value.real, value.imag]:
                    image[:, c] += albedo[:, c] * part * light[:, k, None, None]
                    k += 1
    return image


@pytest.mark.parametrize(
    ("form", "order"), [(f, o) for f, (_, top, _) in FORMS.items() for o in range(top + 1)]
)
def test_equals_scipy(form: str, order: int) -> None:
    render, _, tolerance = FORMS[form]
    scene = _scene(2, order)
    np.testing.assert_allclose(
        render(*scene), _scipy_render(*scene, order), rtol=0, atol=max(tolerance, 2e-13)
    )


@pytest.mark.parametrize("form", FORMS)
def test_white_furnace(form: str) -> None:
    """A constant environment of radiance 1 shades every normal by 1, so the image is the albedo."""
    render, _, tolerance = FORMS[form]
    normal, albedo, _ = _scene(2, 2)
    radiance = np.zeros((9, 3))
    radiance[0] = np.sqrt(4 * np.pi)
    light = Radiance(radiance).to_shading().flat()[None]
    np.testing.assert_allclose(render(normal, albedo, light), albedo, rtol=0, atol=tolerance)
    np.testing.assert_allclose(SHADINGS[form](normal, light), np.ones_like(albedo), rtol=0, atol=tolerance)


@pytest.mark.parametrize("form", FORMS)
def test_sphere_under_one_directional_light(form: str) -> None:
    """Order 2 of max(mu, 0) is 1/4 + mu/2 + 5/32 (3 mu^2 - 1): a white sphere of irradiance pi shows that."""
    size = 33
    x, y = np.meshgrid(np.linspace(-1, 1, size), np.linspace(1, -1, size))
    inside = x * x + y * y < 1
    z = np.sqrt(np.maximum(1 - x * x - y * y, 0))
    normal = np.where(inside, np.stack([x, y, z]), 0)[None]
    toward = np.array([0.6, 0.48, 0.64])  # right, above, in front
    mu = np.tensordot(toward, normal[0], axes=1)
    expected = np.where(inside, 1 / 4 + mu / 2 + 5 / 32 * (3 * mu * mu - 1), 0)
    light = Radiance(np.pi * sh_basis(toward, 2)[:, None] * [1, 0.5, 0.25]).to_shading().flat()[None]
    image = FORMS[form][0](normal, np.ones_like(normal), light)
    for c, colour in enumerate((1, 0.5, 0.25)):
        np.testing.assert_allclose(image[0, c] * inside, colour * expected, rtol=0, atol=FORMS[form][2])
    row, column = np.unravel_index(np.argmax(image[0, 0] * inside), inside.shape)
    assert row < size // 2 < column, "the bright side faces the light: above and to the right"


@pytest.mark.parametrize("form", FORMS)
def test_plane_facing_the_viewer_under_frontal_light(form: str) -> None:
    """n = l: the order-2 peak of 1.0625 everywhere, whatever the normals' length."""
    normal = np.zeros((1, 3, 4, 4))
    normal[:, 2] = np.linspace(0.1, 7, 16).reshape(4, 4)
    light = Radiance(np.pi * sh_basis([0, 0, 1], 2)[:, None] * np.ones(3)).to_shading().flat()[None]
    image = FORMS[form][0](normal, np.full_like(normal, 0.5), light)
    np.testing.assert_allclose(image, 0.5 * 1.0625, rtol=0, atol=FORMS[form][2])


@pytest.mark.parametrize("form", ["torch", "drjit"])
@pytest.mark.parametrize("length", [0.0, 1e-8, 1e-6, 1e-3])
def test_short_normals_agree(form: str, length: float) -> None:
    """All forms share the floor of the normalisation, the zero vector included."""
    normal, albedo, light = _scene(1, 4)
    normal *= length / np.linalg.norm(normal, axis=1, keepdims=True)
    expected = shading_numpy.f_render(normal, albedo, light)
    np.testing.assert_allclose(FORMS[form][0](normal, albedo, light), expected, rtol=0, atol=5e-6)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("length", [1e4, 1e15, 1e25])
def test_long_normals_agree(form: str, length: float) -> None:
    """The square of the last two, or its derivative, has no float32."""
    function, _, tolerance = FORMS[form]
    normal, albedo, light = _scene(2, 2)
    expected = function(normal, albedo, light)
    np.testing.assert_allclose(function(length * normal, albedo, light), expected, atol=tolerance)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("single", [(0,), (1,), (2,), (0, 1), (1, 2), (0, 2)])
def test_a_batch_of_one_broadcasts(form: str, single: tuple[int, ...]) -> None:
    scene = _scene(3, 2)
    small = [a[:1] if i in single else a for i, a in enumerate(scene)]
    full = [np.repeat(a[:1], 3, axis=0) if i in single else a for i, a in enumerate(scene)]
    render = FORMS[form][0]
    np.testing.assert_allclose(render(*small), render(*full), rtol=0, atol=1e-6)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("shapes", "message"),
    [
        (((2, 3, 4, 5), (2, 3, 4, 5), (2, 28)), "light: 28 coefficients"),
        (((2, 3, 4, 5), (2, 3, 4, 5), (2, 300)), "light: 300 coefficients"),
        (((2, 3, 4, 5), (2, 3, 4, 5), (27,)), "light: shape (27,)"),
        (((2, 3, 4, 5), (2, 3, 4, 5), (3, 27)), "normal: shape (2, 3, 4, 5) found, a batch of 3"),
        (((2, 3, 4, 5), (2, 3, 5, 4), (2, 27)), "albedo: shape (2, 3, 5, 4)"),
        (((2, 4, 4, 5), (2, 3, 4, 5), (2, 27)), "normal: shape (2, 4, 4, 5)"),
        (((2, 4, 5, 3), (2, 4, 5, 3), (2, 27)), "normal: shape (2, 4, 5, 3)"),
        (((0, 3, 4, 5), (0, 3, 4, 5), (0, 27)), "normal: shape (0, 3, 4, 5)"),
    ],
)
def test_bad_shapes_are_named(form: str, shapes: tuple[Any, ...], message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        FORMS[form][0](*(np.ones(s) for s in shapes))


@pytest.mark.parametrize("module", [shading_torch, shading_drjit])
def test_dtypes(module: Any) -> None:
    """Half precision is raised to float32; float64 is kept and equals the oracle to its last digits."""
    scene = _scene(2, 4)
    for dtype, result in ((torch.bfloat16, torch.float32), (torch.float64, torch.float64)):
        image = module.f_render(*(torch.tensor(a, dtype=dtype) for a in scene))
        assert image.dtype == result
    # Worst of 20 scenes 3e-15.
    np.testing.assert_allclose(image.numpy(), shading_numpy.f_render(*scene), rtol=0, atol=1e-14)


@pytest.mark.parametrize("module", [shading_numpy, shading_torch, shading_drjit])
def test_more_numbers_than_an_index_reaches_are_refused(module: Any) -> None:
    """Views that cost no memory; 1.5 times 2^31 numbers."""
    view = torch.ones(1, 3, 1, 1).expand(1, 3, 2**15, 2**15)
    taken = view.numpy() if module is shading_numpy else view
    with pytest.raises(InputError, match="split the batch"):
        module.f_render(taken, taken, np.ones((1, 27)) if module is shading_numpy else torch.ones(1, 27))
