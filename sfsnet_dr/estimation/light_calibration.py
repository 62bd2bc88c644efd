"""Where the lamps of a rig were, from its pictures and a first guess at the faces.

Photometric stereo needs the directions of the lamps. Without them pictures of a face tell its shape up to a
linear map: albedo times normal b and lamps l explain a picture I = b . l as well as A b and A^-T l do. A
network that answers from single pictures knows roughly what is right: the mean of its normals over all the
lamps of a capture is off by some ten degrees, but smoothly, which a linear map can hardly be. So

1. for each capture, by turns, lamps by robust least squares from the normals and normals from the lamps
   (``photometric_stereo.fit_pixels``), beginning with the network's mean normals;
2. all captures share the lamps, which the same name means: their median over the captures, in which the
   captures' own maps A, mostly pitch, cancel;
3. the same turns again with one set of lamps for all captures;
4. what a network gets wrong in everybody alike is still in the lamps, first of all how far people look up.
   Where it is given what rendered heads have there on average, all is turned as one until the captures'
   normals lie nearest to that: heads differ from each other, but are not all turned one way.

How steep faces are is left open by all this: ``usual_slopes``. No direction is read.

Sources: the ambiguity, Hayakawa, JOSA A 1994, and Belhumeur, Kriegman and Yuille, IJCV 1999; robust weights
as in ``fit.photometric_stereo``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.estimation.photometric_stereo import GRAZING, SCALE, fit_pixels, is_valid, normal_matrix
from sfsnet_dr.metrics.normals import angles_deg

Array = npt.NDArray[np.float64]

#: Lamps below which a capture does not tell them from its shape.
FEWEST: Final = 12
#: A lamp with less than this of the median strength lights next to nothing in the masks; what was found for
#: it means nothing.
_DARKEST: Final = 0.2
#: A lamp that is found so far from where the network saw it has been lost, degrees.
_FARTHEST: Final = 60.0
#: Turns with a capture's own lamps, and with those of all.
_OWN_TURNS: Final = 6
_SHARED_TURNS: Final = 6
#: Reweighting in each turn.
_REWEIGHTED: Final = 5
#: Quantile over the lamps that a pixel's albedo is guessed from.
_BRIGHT: Final = 0.8


@dataclass(frozen=True, eq=False)
class InitialNormals:
    """Pixels of one capture, and what a network says about them.

    Attributes:
        values: linear, 0 to 1, (P, N).
        lamps: their names, N; a name means the same lamp in every capture.
        normal: unit normals, (P, 3): the mean of the network's over the lamps.
        direction: toward the lamps as the network sees them, (N, 3).
        usual: mean normals of heads that look straight ahead, at these pixels, (P, 3): shorter where heads
            differ, 0 where they are not known; None to believe the network's directions.
    """

    values: Array
    lamps: tuple[str, ...]
    normal: Array
    direction: Array
    usual: Array | None = None


@dataclass(frozen=True)
class CalibratedLights:
    """What was found.

    Attributes:
        direction: unit vectors by name.
        lost: names of lamps that cannot be found, with the reason.
        strength: by name, in the unit of the pictures' albedo.
    """

    direction: Mapping[str, Array] = field(default_factory=dict)
    lost: Mapping[str, str] = field(default_factory=dict)
    strength: Mapping[str, float] = field(default_factory=dict)

    def for_stretched(self, across: float, down: float) -> CalibratedLights:
        """The lamps that explain the same pictures with n_x and n_y of all surfaces times two factors."""
        lamps = {
            name: self.strength[name] * direction / np.array([across, down, 1.0])
            for name, direction in self.direction.items()
        }
        strength = {name: float(np.linalg.norm(lamp)) for name, lamp in lamps.items()}
        return replace(self, direction={name: _unit(lamp) for name, lamp in lamps.items()}, strength=strength)


@dataclass(frozen=True, eq=False)
class _Fit:
    """A capture, which values mean something, scaled normals (P, 3), and lamps times strength (N, 3)."""

    guess: InitialNormals
    valid: Array
    scaled: Array
    lamps: Array


def calibrate_lights(captures: Sequence[InitialNormals]) -> CalibratedLights:
    """Directions of lamps that all captures share; a thousand pixels of each are enough.

    Raises:
        InputError: if no capture has as many lamps as are needed.
    """
    enough = [guess for guess in captures if len(guess.lamps) >= FEWEST]
    if not enough:
        most = max((len(guess.lamps) for guess in captures), default=0)
        raise InputError(
            f"captures: {most} lamps at most found, {FEWEST} in one capture are needed to find where they are"
        )
    fits = _of_one_brightness([_alone(guess) for guess in enough])
    names = sorted({name for fit in fits for name in fit.guess.lamps})
    places = [np.array([names.index(name) for name in fit.guess.lamps]) for fit in fits]
    shared = _median(fits, places, len(names))
    for _ in range(_SHARED_TURNS):
        shared = _shared_lamps(fits, places, shared)
        fits = [_with_lamps(fit, shared[place]) for fit, place in zip(fits, places, strict=True)]
    turn = _straightened(fits)
    return _named(names, shared @ turn.T, _seen(fits, places, len(names)) @ turn.T)


def _alone(guess: InitialNormals) -> _Fit:
    """Turns of lamps and normals of one capture, kept in the frame of the network's normals."""
    scaled = guess.normal * np.quantile(guess.values, _BRIGHT, axis=1)[:, None]
    facing = np.median(np.maximum(scaled @ guess.direction.T, 0), axis=0)
    lamps = guess.direction * (np.median(guess.values, axis=0) / np.maximum(facing, 1e-6))[:, None]
    fit = _Fit(guess, is_valid(guess.values), scaled, lamps)
    for _ in range(_OWN_TURNS):
        for _ in range(_REWEIGHTED):
            fit = replace(fit, lamps=_solved(*_lamp_sums(fit)))
        fit = _with_lamps(fit, fit.lamps)
    turn = _rotation(_unit(fit.scaled), guess.normal)
    return replace(fit, scaled=fit.scaled @ turn.T, lamps=fit.lamps @ turn.T)


def _with_lamps(fit: _Fit, lamps: Array) -> _Fit:
    """The normals that go with lamps."""
    strength = np.maximum(np.linalg.norm(lamps, axis=1), 1e-9)
    scaled, _ = fit_pixels(
        fit.guess.values / strength, fit.valid, lamps / strength[:, None], rounds=_REWEIGHTED
    )
    return replace(fit, scaled=scaled, lamps=lamps)


def _lamp_sums(fit: _Fit) -> tuple[Array, Array]:
    """Sums of w b b^T (N, 3, 3) and w I b (N, 3) over the pixels that a lamp explains."""
    weights = _weights(fit)
    return normal_matrix(weights.T, fit.scaled, 0.0), (weights * fit.guess.values).T @ fit.scaled


def _weights(fit: _Fit) -> Array:
    """Cauchy's, of pixels that face a lamp, (P, N)."""
    unit = np.linalg.norm(fit.scaled, axis=1)[:, None] * np.linalg.norm(fit.lamps, axis=1) + 1e-9
    model = fit.scaled @ fit.lamps.T
    ratio = (fit.guess.values - model) / (SCALE * unit)
    return np.asarray(fit.valid * (model > GRAZING * unit) / (1 + ratio * ratio))


def _solved(matrix: Array, right: Array) -> Array:
    """Lamps (N, 3); the ridge keeps those solvable that light nothing."""
    ridge = 1e-4 * np.trace(matrix, axis1=1, axis2=2)[:, None, None] + 1e-6
    return np.asarray(np.linalg.solve(matrix + ridge * np.eye(3), right[..., None])[..., 0])


def _of_one_brightness(fits: Sequence[_Fit]) -> list[_Fit]:
    """Captures scaled so that their lamps are equally strong: bright skin is not a strong lamp."""
    strength: dict[str, list[float]] = {}
    logs = [np.log(np.linalg.norm(fit.lamps, axis=1) + 1e-9) for fit in fits]
    for fit, values in zip(fits, logs, strict=True):
        for name, value in zip(fit.guess.lamps, values - np.median(values), strict=True):
            strength.setdefault(name, []).append(float(value))
    common = {name: float(np.median(values)) for name, values in strength.items()}
    scaled = []
    for fit, values in zip(fits, logs, strict=True):
        gain = np.exp(np.median(values - np.array([common[name] for name in fit.guess.lamps])))
        scaled.append(replace(fit, scaled=fit.scaled * gain, lamps=fit.lamps / gain))
    return scaled


def _median(fits: Sequence[_Fit], places: Sequence[npt.NDArray[np.intp]], count: int) -> Array:
    """Of each lamp's vectors over the captures, (count, 3)."""
    table = np.full((len(fits), count, 3), np.nan)
    for row, fit, place in zip(table, fits, places, strict=True):
        row[place] = fit.lamps
    return np.asarray(np.nanmedian(table, axis=0))


def _shared_lamps(fits: Sequence[_Fit], places: Sequence[npt.NDArray[np.intp]], lamps: Array) -> Array:
    """One set of lamps for all captures."""
    matrix, right = np.zeros((len(lamps), 3, 3)), np.zeros((len(lamps), 3))
    for fit, place in zip(fits, places, strict=True):
        own_matrix, own_right = _lamp_sums(replace(fit, lamps=lamps[place]))
        matrix[place] += own_matrix
        right[place] += own_right
    return _solved(matrix, right)


def _straightened(fits: Sequence[_Fit]) -> Array:
    """The rotation that makes all captures together look where heads usually do, (3, 3)."""
    known = [(_unit(fit.scaled), fit.guess.usual) for fit in fits if fit.guess.usual is not None]
    if not known:
        return np.eye(3)
    found, usual = (np.concatenate(part) for part in zip(*known, strict=True))
    return _rotation(found, usual)


def _seen(fits: Sequence[_Fit], places: Sequence[npt.NDArray[np.intp]], count: int) -> Array:
    """Where the network saw the lamps, mean over the captures, (count, 3)."""
    total = np.zeros((count, 3))
    for fit, place in zip(fits, places, strict=True):
        total[place] += fit.guess.direction
    return _unit(total)


def _named(names: Sequence[str], lamps: Array, seen: Array) -> CalibratedLights:
    strength = np.linalg.norm(lamps, axis=1)
    share = strength / np.median(strength)
    directions = _unit(lamps)
    away = angles_deg(directions, seen)
    found, lost = {}, {}
    for number, name in enumerate(names):
        if share[number] < _DARKEST:
            lost[name] = (
                f"found with {100 * share[number]:.0f} % of the usual strength, {100 * _DARKEST:.0f} % needed"
            )
        elif away[number] > _FARTHEST:
            lost[name] = (
                f"found {away[number]:.0f} degrees from where the network sees it, {_FARTHEST:.0f} allowed"
            )
        else:
            found[name] = directions[number]
    return CalibratedLights(found, lost, {name: float(strength[names.index(name)]) for name in found})


def _rotation(found: Array, wanted: Array) -> Array:
    """The rotation that brings unit vectors nearest to others, (3, 3)."""
    u, _, v = np.linalg.svd(wanted.T @ found)
    return np.asarray(u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))
