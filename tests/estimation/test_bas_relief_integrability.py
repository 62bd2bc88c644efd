"""Normals that are stretched in the vertical, against surfaces whose heights are known."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from sfsnet_dr.estimation.bas_relief import vertical_scale_from_integrability

Array = npt.NDArray[np.float64]

SIZE = 96


def surface(seed: int, noise: float = 0.0) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Scaled normals of a wide bump with smaller ones on it, from the derivatives of its height."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[SIZE:0:-1, 0:SIZE] - 0.5
    p, q = np.zeros((2, SIZE, SIZE))
    bumps = [(SIZE / 2, SIZE / 2, 40.0, 40.0)]
    bumps += [(*rng.uniform(20, 76, 2), rng.uniform(6, 12), rng.uniform(-4, 4)) for _ in range(8)]
    for a, b, width, height in bumps:
        bump = height * np.exp(-((x - a) ** 2 + (y - b) ** 2) / (2 * width**2))
        p, q = p - bump * (x - a) / width**2, q - bump * (y - b) / width**2
    normal = np.stack([-p, -q, np.ones_like(p)], -1) / np.sqrt(1 + p * p + q * q)[..., None]
    normal = normal + noise * rng.normal(size=normal.shape)
    albedo = np.where(x + y < SIZE, 0.3, 0.6)  # an edge of paint is no edge of the surface
    mask = (x - SIZE / 2) ** 2 + (y - SIZE / 2) ** 2 < 40**2
    return normal * albedo[..., None], mask


@pytest.mark.parametrize("ratio", [0.85, 1.0, 1.2])
def test_a_stretch_is_undone(ratio: float) -> None:
    faces = [(normal / np.array([1, ratio, 1]), mask) for normal, mask in map(surface, range(3))]
    assert vertical_scale_from_integrability(faces) == pytest.approx(
        ratio, abs=0.005
    )  # what finite differences leave


def test_noise_and_wrong_pixels_move_it_little() -> None:
    faces = []
    for seed in range(4):
        normal, mask = surface(seed, noise=0.01)
        normal[40:50, 20:30] = [0.0, 0.0, 0.5]
        faces.append((normal / np.array([1, 1.15, 1]), mask))
    assert vertical_scale_from_integrability(faces) == pytest.approx(1.15, abs=0.05)


def test_noise_in_both_slopes_does_not_draw_the_ratio_to_1() -> None:
    faces = [surface(seed, noise=0.02) for seed in range(4)]
    flat = [(normal / np.array([1, 1.15, 1]), mask) for normal, mask in faces]
    assert vertical_scale_from_integrability(flat) == pytest.approx(
        1.15, abs=0.01
    )  # 1.131 without the average


def test_what_it_cannot_tell_stays() -> None:
    """Depth and a stretch of both axes keep the rule of surfaces; faces of few pixels say nothing."""
    normal, mask = surface(0)
    for factors in ([1, 1, 0.7], [1.2, 1.2, 1]):
        assert vertical_scale_from_integrability([(normal * np.array(factors), mask)]) == pytest.approx(
            1.0, abs=0.005
        )
    assert vertical_scale_from_integrability([]) == 1.0
    assert vertical_scale_from_integrability([(normal, np.zeros_like(mask))]) == 1.0
