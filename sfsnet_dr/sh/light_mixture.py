"""A distribution of lights: a mixture of normal distributions over the 27 shading coefficients.

The numbers live in a small JSON file, so that what was learnt from photographs travels without them.
Coefficients are in units in which a face's mean shading (``metered``) has the luminance 1.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.base.atomic import write_text
from sfsnet_dr.base.checks import BadInput, check_shape
from sfsnet_dr.base.conventions import LIGHT_ORDER, LIGHT_SIZE
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.icosphere import icosphere

Array = NDArray[np.float64]

#: The mixture that comes with the package.
FITTED: Final = Path(__file__).with_name("fitted_lights.json")

#: Greatest angle from the viewer's direction of normals that count as visible, degrees.
VISIBLE: Final = 70.0

_FORMAT: Final = "sfsnet_dr.light_mixture.1"
_MOST_DRAWS: Final = 1000


@dataclass(frozen=True, eq=False)
class LightMixture:
    """K components over lights of 27 numbers (9 R, 9 G, 9 B shading coefficients).

    Attributes:
        shares: probability of each component, (K,); they sum to 1.
        means: (K, 27).
        factors: lower triangular roots of the covariances, (K, 27, 27).
        source: what it was learnt from, for people to read: how many photographs, residuals.
    """

    shares: Array
    means: Array
    factors: Array
    source: Mapping[str, Any]

    def __post_init__(self) -> None:
        sizes = check_shape("shares", self.shares, "K")
        check_shape("means", self.means, f"K {LIGHT_SIZE}", **sizes)
        check_shape("factors", self.factors, f"K {LIGHT_SIZE} {LIGHT_SIZE}", **sizes)
        finite = all(np.isfinite(part).all() for part in (self.shares, self.means, self.factors))
        if not finite or (self.shares < 0).any() or abs(float(self.shares.sum()) - 1) > 1e-6:
            raise BadInput("mixture: shares from 0 on that sum to 1, finite means and factors are needed")

    @property
    def digest(self) -> str:
        """Hash of the numbers; the same for the same distribution."""
        parts = (self.shares, self.means, self.factors)
        return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()[
            :16
        ]

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Lights (count, 27) as the mixture has them, physically possible or not."""
        component = rng.choice(len(self.shares), size=count, p=self.shares / self.shares.sum())
        noise = rng.normal(size=(count, LIGHT_SIZE))
        return np.asarray(self.means[component] + np.einsum("nij,nj->ni", self.factors[component], noise))

    def sample(self, rng: np.random.Generator) -> Array:
        """A light (27,) that shades no visible normal negatively; others are drawn again.

        Raises:
            BadInput: if a thousand draws gave none.
        """
        for _ in range(_MOST_DRAWS):
            light = self.draw(rng, 1)[0]
            if lights_visibly(light[None])[0]:
                return np.asarray(light)
        raise BadInput(f"mixture: none of {_MOST_DRAWS} lights is positive on visible normals; fit it anew")

    def moments(self) -> tuple[Array, Array]:
        """Mean (27,) and covariance (27, 27) of the whole."""
        mean = self.shares @ self.means
        apart = self.means - mean
        within = np.einsum("k,kij,klj->il", self.shares, self.factors, self.factors)
        return mean, within + np.einsum("k,ki,kj->ij", self.shares, apart, apart)


def lights_visibly(lights: Array) -> NDArray[np.bool_]:
    """Whether lights (N, 27) shade no normal within ``VISIBLE`` degrees of the viewer negatively, (N,)."""
    directions = icosphere(3)
    near = directions[directions[:, 2] >= np.cos(np.radians(VISIBLE))]
    shading = lights.reshape(-1, 3, LIGHT_SIZE // 3) @ sh_basis(near, LIGHT_ORDER).T
    return np.asarray((shading >= 0).all(axis=(1, 2)))


def write_mixture(path: Path | str, mixture: LightMixture) -> None:
    """Write a mixture with five digits; of the factors the lower triangles row by row."""
    rows, columns = np.tril_indices(LIGHT_SIZE)
    plain = {
        "format": _FORMAT,
        "source": dict(mixture.source),
        "shares": [float(share) for share in mixture.shares],
        "means": [_rounded(mean) for mean in mixture.means],
        "factors": [_rounded(factor[rows, columns]) for factor in mixture.factors],
    }
    lines = ",\n".join(f"{json.dumps(key)}: {_lines(value)}" for key, value in plain.items())
    write_text(path, "{\n" + lines + "\n}\n")


def read_mixture(path: Path | str = FITTED) -> LightMixture:
    """Read what ``write_mixture`` wrote.

    Raises:
        BadInput: for a missing or damaged file, or one of another format.
    """
    rows, columns = np.tril_indices(LIGHT_SIZE)
    try:
        plain = json.loads(Path(path).read_text(encoding="utf-8"))
        if plain["format"] != _FORMAT:
            raise ValueError(f"format {plain['format']!r}")
        shares = np.array(plain["shares"], np.float64)
        factors = np.zeros((len(shares), LIGHT_SIZE, LIGHT_SIZE))
        factors[:, rows, columns] = plain["factors"]
        return LightMixture(shares, np.array(plain["means"], np.float64), factors, plain["source"])
    except FileNotFoundError as error:
        raise BadInput(f"{path}: no such file; `sfsnet-dr fit-lights` writes one") from error
    except (OSError, ValueError, KeyError, TypeError, BadInput) as error:
        raise BadInput(f"{path}: no mixture of lights ({error}); {_FORMAT} is needed") from error


def _rounded(values: Array) -> list[float]:
    return [float(f"{value:.5g}") for value in values]


def _lines(value: object) -> str:
    if isinstance(value, list) and value and isinstance(value[0], list):
        return "[\n" + ",\n".join(json.dumps(row) for row in value) + "\n]"
    return json.dumps(value)
