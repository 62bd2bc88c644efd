"""The light under which a model is most wrong, found from quadratic forms.

The error of a light l is sqrt(l^T A l / max(l^T B l, d^2 s l^T l)): A and B are the mean squares of error and
image (``study.light_answers.Forms``), s is the largest eigenvalue of B. The second term keeps lights out of
which next to nothing arrives at the pixels that are seen: an image dimmer than the share d of the brightest
one that a light of the same energy gives counts as that bright.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh
from scipy.optimize import minimize, minimize_scalar

from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.kernel import order_of

Array = npt.NDArray[np.float64]

_LEAST_LOG_T = -14.0  # at t = 0 the truth alone would stand there, which may be singular
_MIXTURES = np.linspace(0.0, np.pi, 361)[:-1]


@dataclass(frozen=True, eq=False)
class WorstLightResult:
    """A light and how wrong the model is under it.

    Attributes:
        light: (K,) radiance coefficients, of length 1, with a first one of at least 0.
        error: the error above.
        bound: what no light exceeds; infinity where the search cannot know.
        brightness: of its image, relative to the brightest that a light of this energy gives.
        colour: number of the channel whose forms these were.
    """

    light: Array
    error: float
    bound: float
    brightness: float
    colour: int = 0


def relative_errors(lights: Array, error: Array, truth: Array, dimmest: float) -> Array:
    """(...,) the error above of lights (..., K); forms (K, K)."""
    power = np.maximum(_squared(lights, truth), dimmest**2 * _brightest(truth) * (lights**2).sum(axis=-1))
    return np.asarray(np.sqrt(np.maximum(_squared(lights, error), 0.0) / power))


def worst_signed(error: Array, truth: Array, dimmest: float) -> WorstLightResult:
    """Over all lights, negative ones included.

    The maximum over lights of a quotient with max(p, q) below is the minimum over t of the maximum with
    (1 - t) p + t q, since three quadratic forms have a convex joint range (Brickman 1961; Polyak 1998). So it
    is the least of a family of generalised eigenvalues, which is quasi-convex in t: ``bound``. The light is
    an eigenvector, or a mixture of two where two eigenvalues meet.

    Args:
        error: (K, K).
        truth: (K, K).
        dimmest: d, above 0.
    """
    values, vectors = np.linalg.eigh(truth)
    truth = (vectors * np.maximum(values, 0.0)) @ vectors.T  # what is negative is noise
    floor = dimmest**2 * _brightest(truth) * np.eye(len(truth))

    def top(logarithm: float) -> tuple[Array, Array]:
        t = np.exp(logarithm)
        values, vectors = eigh(error, (1 - t) * truth + t * floor)
        return values, vectors

    found = minimize_scalar(
        lambda x: top(x)[0][-1], bounds=(_LEAST_LOG_T, 0.0), method="bounded", options={"xatol": 1e-7}
    )
    values, vectors = top(found.x)
    few = [vectors[:, -1]]
    for x in np.clip(found.x + np.array([-1e-5, 1e-5]), _LEAST_LOG_T, 0.0):
        few += [*top(float(x))[1][:, -3:].T]
    cosine, sine = np.cos(_MIXTURES)[:, None], np.sin(_MIXTURES)[:, None]
    lights = np.concatenate([cosine * one + sine * other for one in few for other in few])
    lights = lights[(lights**2).sum(axis=1) > 1e-9 * (few[0] @ few[0])]  # a vector and its opposite cancel
    best = lights[np.argmax(relative_errors(lights, error, truth, dimmest))]
    return _worst(best, error, truth, dimmest, bound=float(np.sqrt(values[-1])))


def worst_non_negative(
    error: Array, truth: Array, dimmest: float, *, starts: int = 6, seed: int = 0
) -> WorstLightResult:
    """Over lights of the same order whose radiance is negative nowhere; a local search from many starts.

    Such a light is a sum of squares of expansions of half the order, q^T C C^T q: searched are the C. What is
    found is a light that exists, so that the true maximum may be larger, but not smaller.

    Args:
        error: (K, K) of an even order.
        truth: (K, K).
        dimmest: d, above 0.
        starts: number of random starts.
        seed: of the starts.
    """
    products = squared_error_matrix(order_of(len(truth)))
    count, size, _ = products.shape
    flat = products.reshape(count, -1)
    floor = dimmest**2 * _brightest(truth)

    def light_of(root: Array) -> Array:
        return np.asarray(flat @ (root @ root.T).ravel())

    def objective(values: Array) -> tuple[float, Array]:
        root = values.reshape(size, -1)
        light = light_of(root)
        wrong, image, energy = light @ error @ light, light @ truth @ light, floor * (light @ light)
        power, slope = (image, truth @ light) if image > energy else (energy, floor * light)
        upon_light = 2 * (error @ light / power - wrong / power**2 * slope)
        upon_root = 2 * (upon_light @ flat).reshape(size, size) @ root
        return -float(wrong / power), -upon_root.ravel()

    rng = np.random.default_rng(seed)
    ranks = [(1, 2, size)[k % 3] for k in range(starts)]
    best = min((_descend(objective, rng.normal(size=size * rank)) for rank in ranks), key=lambda end: end[0])
    return _worst(light_of(best[1].reshape(size, -1)), error, truth, dimmest, bound=np.inf)


def squared_error_matrix(order: int) -> Array:
    """(K, k, k): coefficients to an even order of the products of two basis functions of half that order."""
    heights, weights = np.polynomial.legendre.leggauss(order + 2)  # exact for products of three
    turns = 2 * np.pi * np.arange(2 * order + 2) / (2 * order + 2)
    radius = np.sqrt(1 - heights**2)
    x, y = np.outer(radius, np.cos(turns)), np.outer(radius, np.sin(turns))
    points = np.stack([x, y, np.broadcast_to(heights[:, None], x.shape)], axis=-1)
    half, full = sh_basis(points, order // 2), sh_basis(points, order)
    area = weights * (2 * np.pi / len(turns))
    return np.asarray(np.einsum("abk,abi,abj,a->kij", full, half, half, area, optimize=True))


def _descend(objective: Callable[[Array], tuple[float, Array]], start: Array) -> tuple[float, Array]:
    # Conjugate gradients: L-BFGS calls BLAS on 81 numbers, which takes 25 times longer on busy cores.
    result = minimize(objective, start, jac=True, method="CG", options={"maxiter": 150})
    return float(result.fun), np.asarray(result.x)


def _worst(light: Array, error: Array, truth: Array, dimmest: float, bound: float) -> WorstLightResult:
    light = light / np.linalg.norm(light)
    light = light if light[0] >= 0 else -light
    brightness = np.sqrt(max(float(_squared(light, truth)), 0.0) / _brightest(truth))
    return WorstLightResult(
        light, float(relative_errors(light, error, truth, dimmest)), bound, float(brightness)
    )


def _squared(lights: Array, form: Array) -> Array:
    return np.asarray(((lights @ form) * lights).sum(axis=-1))


def _brightest(truth: Array) -> float:
    return float(np.linalg.eigvalsh(truth)[-1])
