"""Directions of a divided icosahedron."""

from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.icosphere import icosphere, icosphere_solid_angles


@pytest.mark.parametrize(("level", "count"), [(0, 12), (1, 42), (3, 642)])
def test_count_length_and_distance(level: int, count: int) -> None:
    directions = icosphere(level)
    assert directions.shape == (count, 3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-15)
    cosines = directions @ directions.T - 2 * np.eye(count)
    nearest = np.degrees(np.arccos(cosines.max(axis=1)))
    # Edges of an icosahedron span 63.43 degrees; each division halves them, at corners more than between.
    assert nearest.max() <= 63.435 / 2**level * 1.2
    assert nearest.min() >= 63.435 / 2**level * 0.85


def test_sums_over_directions_are_integrals() -> None:
    """Full symmetry makes plain sums exact to order 5, as for the icosahedron; areas are even to a third."""
    directions, areas = icosphere(3), icosphere_solid_angles(3)
    assert areas.sum() == pytest.approx(4 * np.pi, abs=1e-12)
    assert areas.max() / areas.min() < 4 / 3
    sums = sh_basis(directions, 5).sum(axis=0) * 4 * np.pi / len(directions)
    np.testing.assert_allclose(sums, [np.sqrt(4 * np.pi), *[0.0] * 35], atol=1e-12)


def test_a_level_out_of_range_is_refused() -> None:
    with pytest.raises(InputError, match="level: 7 found, 0 to 6 allowed"):
        icosphere(7)
