"""How much too flat faces were found, against heads that are known."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.estimation.bas_relief import FEWEST_HEADS, resolve_bas_relief_scale

Array = npt.NDArray[np.float64]

SIZE = 48
ALL = np.ones((SIZE, SIZE), bool)


def head(seed: int | None = None, depth: float = 1.0, turned: float = 0.0) -> Array:
    """Unit normals of a bump, with small bumps of its own if a seed is given."""
    y, x = np.mgrid[1 : -1 : SIZE * 1j, -1 : 1 : SIZE * 1j]
    p, q = 1.4 * x, 1.1 * y
    if seed is not None:
        a, b = np.random.default_rng(seed).uniform(0, 6, size=(2, 1, 1))
        p, q = p + 0.6 * np.sin(9 * x + a), q + 0.6 * np.sin(9 * y + b)
    normal = np.stack([depth * p, depth * q, np.ones_like(p)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    c, s = np.cos(np.radians(turned)), np.sin(np.radians(turned))
    return np.asarray(normal @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T)


HEADS = [(head(seed), ALL) for seed in range(40)]


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.3])
def test_a_factor_is_found_whatever_the_albedo(factor: float) -> None:
    albedo = np.random.default_rng(0).uniform(0.2, 0.6, (SIZE, SIZE, 1))
    faces = [(albedo * head(seed, depth=1 / factor), ALL) for seed in range(100, 140)]
    # Slopes beyond the steepest are left out, of deep faces more: 0.81, 1.00 and 1.28 measured.
    assert resolve_bas_relief_scale(faces, HEADS) == pytest.approx(factor, rel=0.03)


def test_detail_that_lies_elsewhere_in_each_head_counts() -> None:
    """A mean head would be smooth, and a face as bumpy as all heads be taken for too steep."""
    assert resolve_bas_relief_scale([(head(7), ALL)], HEADS) == pytest.approx(1.0, abs=0.02)
    assert resolve_bas_relief_scale([(head(7), ALL)], [(head(), ALL)] * 20) < 0.98


def test_turned_heads_and_hidden_ones_have_no_say() -> None:
    flat = [(head(seed, depth=0.5, turned=25.0), ALL) for seed in range(40)]
    hidden = [(head(seed, depth=0.5), np.arange(SIZE)[None, :] < 20 + 0 * ALL) for seed in range(40)]
    assert (
        resolve_bas_relief_scale(HEADS, [*HEADS, *flat, *hidden])
        == resolve_bas_relief_scale(HEADS, HEADS)
        == 1.0
    )


def test_pixels_that_few_faces_know_have_no_say() -> None:
    known = ALL.copy()
    known[:, 19:29] = False
    wrong = [(np.where(known[..., None], head(seed), [0.8, 0.0, 0.6]), known) for seed in range(40)]
    assert resolve_bas_relief_scale(wrong, HEADS) == pytest.approx(1.0, abs=0.01)


def test_it_says_nothing_of_nothing_and_never_much() -> None:
    assert resolve_bas_relief_scale([], HEADS) == 1.0
    assert resolve_bas_relief_scale([(head(), ~ALL)], HEADS) == 1.0
    assert resolve_bas_relief_scale([(head(depth=0.1), ALL)], HEADS) == 1.5
    assert resolve_bas_relief_scale([(head(depth=1.0), ALL)], [(head(depth=0.2), ALL)] * FEWEST_HEADS) == 0.7


def test_too_few_heads_are_refused() -> None:
    with pytest.raises(InputError, match="heads: 19 found that look ahead"):
        resolve_bas_relief_scale(HEADS, HEADS[:19])
