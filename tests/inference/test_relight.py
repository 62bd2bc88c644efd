"""Relit views: one directional light at order 2, from the side that the name says."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sfsnet_dr.inference.relight import VIEW_LIGHTS, directional_shading, relight, relit_views


def hemisphere(size: int = 64) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Normals (H, W, 3) of a sphere seen from the front, and where it is."""
    x, y = np.meshgrid((np.arange(size) + 0.5) * 2 / size - 1, 1 - (np.arange(size) + 0.5) * 2 / size)
    inside = x**2 + y**2 < 1
    z = np.sqrt(np.where(inside, 1 - x**2 - y**2, 1.0))
    return np.stack([x, y, z], axis=-1), inside


def order_2_cosine(c: NDArray[np.float64]) -> NDArray[np.float64]:
    """Order-2 expansion of max(cos, 0) in closed form, 1/4 + c/2 + 5 (3 c^2 - 1) / 32 (Ramamoorthi 2001)."""
    return np.asarray(0.25 + c / 2 + 5 / 32 * (3 * c**2 - 1))


@pytest.mark.parametrize("name", VIEW_LIGHTS)
def test_a_view_is_the_closed_form_of_order_2(name: str) -> None:
    normal, inside = hemisphere()
    way = np.array(VIEW_LIGHTS[name]) / np.linalg.norm(VIEW_LIGHTS[name])
    image = relight(normal, np.full_like(normal, 0.5), directional_shading(VIEW_LIGHTS[name]))
    unit = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    expected = 0.5 * np.maximum(order_2_cosine(unit @ way), 0)
    # Both are float64 closed forms; rounding only.
    np.testing.assert_allclose(image[..., 1][inside], expected[inside], atol=1e-12)


def test_a_facing_surface_has_seventeen_sixteenths() -> None:
    facing = relight(np.full((1, 1, 3), [0.0, 0, 1]), np.ones((1, 1, 3)), directional_shading((0, 0, 3)))
    np.testing.assert_allclose(facing, 17 / 16, rtol=1e-12)


def test_light_comes_from_the_side_that_is_named() -> None:
    normal, inside = hemisphere()
    views = relit_views(normal, np.ones_like(normal) * inside[..., None])
    assert list(views) == ["left", "right", "top"]
    left, right, top = (view[..., 0] for view in views.values())
    assert left[:, :32].sum() > 2 * left[:, 32:].sum()
    assert right[:, 32:].sum() > 2 * right[:, :32].sum()
    assert top[:32].sum() > 2 * top[32:].sum()
    assert min(view.min() for view in views.values()) == 0
