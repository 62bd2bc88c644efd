"""How much too flat faces were found, against heads that are known."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from sfsnet_dr.fit.usual_slopes import usual_slopes

Array = npt.NDArray[np.float64]

SIZE = 48
ALL = np.ones((SIZE, SIZE), bool)


def head(seed: int | None = None, depth: float = 1.0) -> Array:
    """Unit normals of a bump, with a bump of its own if a seed is given."""
    y, x = np.mgrid[1 : -1 : SIZE * 1j, -1 : 1 : SIZE * 1j]
    p, q = 1.4 * x, 1.1 * y
    if seed is not None:
        a, b = np.random.default_rng(seed).normal(size=(2, 1, 1))
        p, q = p + 0.3 * np.sin(4 * x + a), q + 0.3 * np.sin(4 * y + b)
    normal = np.stack([depth * p, depth * q, np.ones_like(p)], -1)
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.3])
def test_a_factor_is_found_whatever_the_albedo(factor: float) -> None:
    albedo = np.random.default_rng(0).uniform(0.2, 0.6, (SIZE, SIZE, 1))
    faces = [(albedo * head(depth=1 / factor), ALL)] * 2
    assert usual_slopes(faces, 0.9 * head()) == pytest.approx(factor, rel=1e-9)


def test_faces_that_differ_from_heads_do_not_move_it() -> None:
    """Each differs by a tenth and more, flatter or not is told by all of them."""
    faces = [(head(seed, depth=1 / 1.2), ALL) for seed in range(60)]
    # The mean of unit normals is a little flatter than the normal of the mean: 1.22 measured.
    assert usual_slopes(faces, head()) == pytest.approx(1.2, abs=0.04)


def test_unknown_pixels_have_no_say() -> None:
    known = ALL.copy()
    known[:, :20] = False
    wrong = np.where(known[..., None], head(depth=1 / 1.2), [0.8, 0.0, 0.6])
    usual = head() * (np.arange(SIZE) < 40)[None, :, None]
    assert usual_slopes([(wrong, known)], usual) == pytest.approx(1.2, rel=1e-9)
    assert usual_slopes([(wrong, ALL)], usual) != pytest.approx(1.2, rel=0.05)


def test_it_says_nothing_of_nothing_and_never_much() -> None:
    assert usual_slopes([], head()) == 1.0
    assert usual_slopes([(head(), ~ALL)], head()) == 1.0
    assert usual_slopes([(head(depth=0.1), ALL)], head()) == 1.5
    assert usual_slopes([(head(depth=4.0), ALL)], 0.9 * head(depth=0.5)) == 0.7
