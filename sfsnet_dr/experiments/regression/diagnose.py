"""Why an image differs: known faults are fitted to the difference, and the evidence is written."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.color import linear_to_srgb
from sfsnet_dr.core.files import output_dir, write_text
from sfsnet_dr.core.image_io import write_exr
from sfsnet_dr.core.visualize import png_bytes, show_linear
from sfsnet_dr.experiments.regression.expected import Expected, shade_expected
from sfsnet_dr.experiments.regression.matrix import Row
from sfsnet_dr.metrics.equivalence import Estimate, two_sided_p
from sfsnet_dr.render.renderers.base import Capabilities
from sfsnet_dr.render.renderers.sh import surface_maps
from sfsnet_dr.report.plots import error_map
from sfsnet_dr.report.record import dotted_word
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.subject import Subject

Array = npt.NDArray[np.float64]

#: Share of the difference, noise left out, from which a cause is named.
_ENOUGH: Final = 0.5
#: What each further number of a fit has to explain to be believed.
_PRICE: Final = 0.01
_BLOCK: Final = 4
_DEGREE = np.radians(1.0)
_FLATTEST = 0.05  # cosine below which a division by it says nothing

_TURNS: Final[dict[str, Callable[[Array], Array]]] = {
    "mirrored left to right": lambda image: image[:, ::-1],
    "mirrored top to bottom": lambda image: image[::-1],
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
    "transposed (x and y exchanged)": lambda image: np.swapaxes(image, 0, 1),
}
_AXES = {
    "the light's x and y axes exchanged": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]),
    "the light's y and z axes exchanged": np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
    "the light's x and z axes exchanged": np.array([[0.0, 0, 1], [0, 1, 0], [1, 0, 0]]),
    "the light mirrored left to right": np.diag([-1.0, 1, 1]),
    "the light mirrored top to bottom": np.diag([1.0, -1, 1]),
    "the light coming from behind": np.diag([1.0, 1, -1]),
}


@dataclass(frozen=True)
class DifferenceCause:
    """The likeliest cause.

    Attributes:
        words: one line for people.
        share: how much of the squared difference it explains, noise left out; at most 1.
    """

    words: str
    share: float


@dataclass(frozen=True, eq=False)
class _Fit:
    """Patterns (n, H, W, 3) that add up to the difference, and words for their weights.

    A ``whole`` pattern is a defect that is there or not: a weight far below 1 or below 0 is none.
    """

    patterns: list[Array]
    words: str
    whole: bool = False

    def say(self, weights: Array) -> str:
        return self.words.format(*weights)


class _Judge:
    """Judges by sums over small blocks, which quieten the noise, how much of a difference is explained.

    Args:
        difference: (H, W, 3).
        noise: (H, W, 3), its variance.
        allowance: (H, W, 3), what of it is no defect.
    """

    def __init__(self, difference: Array, noise: Array, allowance: Array) -> None:
        self._noise = _sums(noise)
        doubt = self._noise + _sums(allowance) ** 2
        strength = float((_sums(difference) ** 2).mean())
        self._weight = 1.0 / (doubt + 1e-4 * strength + 1e-30)
        self._total = self._left(difference)

    @property
    def sees_anything(self) -> bool:
        """Whether there is more than noise."""
        return self._total > 0

    def share(self, left: Array) -> float:
        """Share of the squared difference that is explained where ``left`` (H, W, 3) is not."""
        return min(1.0 - self._left(left) / self._total, 1.0)

    def weights(self, patterns: Sequence[Array], difference: Array) -> Array:
        """Weights of patterns (H, W, 3) that explain most of a difference, by least squares."""
        root = np.sqrt(self._weight).ravel()
        columns = np.stack([_sums(pattern).ravel() * root for pattern in patterns], axis=1)
        return np.asarray(np.linalg.lstsq(columns, _sums(difference).ravel() * root, rcond=None)[0])

    def _left(self, left: Array) -> float:
        return float((self._weight * (_sums(left) ** 2 - self._noise)).sum())


def diagnose_difference(found: Estimate, truth: Expected) -> DifferenceCause:
    """Name the likeliest cause of the difference between an image and what it should show."""
    image, reference = found.mean, truth.estimate.mean
    difference = image - reference
    judge = _Judge(difference, found.variance + truth.estimate.variance, truth.allowance)
    if not judge.sees_anything:
        return DifferenceCause("no cause found: the difference is hardly more than noise", 0.0)
    best = DifferenceCause("", 0.0)
    for fit in _fits(reference, truth.subject, truth.light, truth.says):
        weights = judge.weights(fit.patterns, difference)
        if fit.whole and not 0.05 < weights[0] < 2.0:
            continue
        share = judge.share(difference - np.tensordot(weights, np.stack(fit.patterns), 1))
        if share - _PRICE * (len(fit.patterns) - 1) > best.share:
            best = DifferenceCause(fit.say(weights), share)
    for words, other in (*_moves(image, reference, judge), *_turned(reference)):
        share = judge.share(image - other)
        if share > best.share:
            best = DifferenceCause(words, share)
    if best.share < _ENOUGH:
        return DifferenceCause(f"no known cause fits; {_where(difference)}", best.share)
    return DifferenceCause(f"{best.words} (explains {100 * best.share:.0f} % of the difference)", best.share)


def _moves(image: Array, reference: Array, judge: _Judge) -> Iterator[tuple[str, Array]]:
    """The reference, moved further and further toward the image (Gauss and Newton), with words."""
    from scipy.ndimage import shift

    at = np.zeros(2)
    for _ in range(6):
        moved = np.asarray(shift(reference, (at[1], at[0], 0.0), order=1, mode="nearest"))
        words = f"moved by {at[0]:+.2f} pixels to the right and {at[1]:+.2f} down: pixel centres, camera"
        yield words, moved
        slopes = [-np.asarray(part) for part in np.gradient(moved, axis=(1, 0))]
        at = np.clip(at + judge.weights(slopes, image - moved), -3.0, 3.0)


def _turned(reference: Array) -> Iterator[tuple[str, Array]]:
    for words, turn in _TURNS.items():
        yield f"the picture is {words}", turn(reference)


def _sums(values: Array) -> Array:
    rows = np.add.reduceat(values, np.arange(0, values.shape[0], _BLOCK), axis=0)
    return np.asarray(np.add.reduceat(rows, np.arange(0, values.shape[1], _BLOCK), axis=1))


def _fits(reference: Array, subject: Subject, light: Light, says: Capabilities) -> Iterator[_Fit]:
    yield _Fit([reference], "brightness x {0:+.2%}: albedo, exposure or a constant factor")
    colours = [reference * (np.arange(3) == c) for c in range(3)]
    yield _Fit(colours, "red {0:+.2%}, green {1:+.2%}, blue {2:+.2%}: colour of albedo or light")
    down, right = (np.asarray(part) for part in np.gradient(reference, axis=(0, 1)))
    yield _Fit([np.ones_like(reference) * (reference > 0)], "a constant {0:+.3g} on the surface")
    curve = linear_to_srgb(np.clip(reference, 0.0, None)) - reference
    yield _Fit([curve], "{0:.0%} of an sRGB curve that should not be there", whole=True)
    offset = (np.arange(reference.shape[0]) + 0.5) / reference.shape[0] * 2 - 1
    zoom = right * offset[None, :, None] + down * offset[:, None, None]
    yield _Fit([-zoom * reference.shape[0] / 2], "magnified by {0:+.2%}: field of view or distance")
    yield from _by_normals(reference, subject, light, says)


def _by_normals(reference: Array, subject: Subject, light: Light, says: Capabilities) -> Iterator[_Fit]:
    """What depends on normals: the light's direction, axes and bands, and the cosine."""
    normal = np.moveaxis(surface_maps(subject).normal[0].astype(np.float64), 0, -1)
    shading = shade_expected(normal, light, says.order)
    bright = np.abs(shading) > 0.02 * np.abs(shading).max()
    # Shading is compared without shadows; what the reference has beyond it (albedo, shadows) is a factor.
    factor = np.where(bright, reference / np.where(bright, shading, 1.0), 0.0)
    turned = []
    for axis in np.eye(3):
        moved = normal - _DEGREE * np.cross(axis, normal)  # turning the light is turning the surface back
        turned.append(factor * (shade_expected(moved, light, says.order) - shading))
    yield _Fit(turned, "the light turned by {0:+.2f}, {1:+.2f}, {2:+.2f} degrees about x, y, z")
    for words, matrix in _AXES.items():
        pattern = factor * (shade_expected(normal @ matrix, light, says.order) - shading)
        yield _Fit([pattern], f"{words}, at {{0:.0%}}", whole=True)
    for order in range(says.order if says.order is not None else 5):
        pattern = factor * (shade_expected(normal, light, order) - shading)
        yield _Fit([pattern], f"{{0:.0%}} of what light of order {order} would change: the order", whole=True)
    for direction, _ in light.directional[:1]:
        cosine = normal @ direction
        lit = cosine > _FLATTEST
        pattern = np.where(lit[..., None], -reference * np.log(np.where(lit, cosine, 1.0))[..., None], 0.0)
        whole = np.where(lit[..., None], reference * (1 / np.where(lit, cosine, 1.0) - 1)[..., None], 0.0)
        yield _Fit([pattern], "the cosine to the power {0:.2f} is missing", whole=True)
        yield _Fit([whole], "{0:.0%} of a missing cosine", whole=True)


def _where(difference: Array) -> str:
    """The 8 x 8 block that differs most, for people."""
    strength = np.abs(difference).sum(axis=-1)
    rows = np.add.reduceat(strength, np.arange(0, strength.shape[0], 8), axis=0)
    blocks = np.add.reduceat(rows, np.arange(0, strength.shape[1], 8), axis=1)
    row, column = np.unravel_index(int(blocks.argmax()), blocks.shape)
    share = blocks.max() / max(blocks.sum(), 1e-30)
    return (
        f"the 8 x 8 block at row {8 * row}, column {8 * column} differs most ({share:.0%} of the difference)"
    )


_CLEAREST = 12.0  # decades of p at the end of the map's scale
_ENLARGED = 4


@dataclass(frozen=True, eq=False)
class Evidence:
    """A failing pair in pictures.

    Attributes:
        row: the pair.
        cause: one line.
        pictures: PNG and label: image, reference, difference, p-values.
    """

    row: Row
    cause: str
    pictures: tuple[tuple[bytes, str], ...]


def gather_evidence(row: Row, folder: Path) -> Evidence:
    """Write the evidence of a pair that differs into a folder of its own below ``folder``."""
    assert row.image is not None
    assert row.truth is not None
    assert row.agreement is not None
    image, reference = row.image.mean, row.truth.estimate.mean
    cause = diagnose_difference(row.image, row.truth).words
    # The most telling colour of each pixel.
    decades = -np.log10(np.maximum(two_sided_p(row.agreement.z), 1e-300)).max(axis=-1)
    pictures = _pictures(image, reference, decades)
    place = output_dir(folder / "failures" / "-".join(map(dotted_word, (row.renderer, row.scene, row.light))))
    planes = {"image": image, "reference": reference, "difference": image - reference}
    channels = {f"{name}.{c}": values[..., k] for name, values in planes.items() for k, c in enumerate("RGB")}
    write_exr(place / "images.exr", channels | {"decades_of_p.Y": decades}, {}, float32=[*channels])
    for png, label in pictures:
        (place / f"{dotted_word(label.split(',')[0])}.png").write_bytes(png)
    write_text(place / "cause.txt", f"{row.renderer}, {row.scene}, {row.light}: {cause}\n")
    return Evidence(row, cause, pictures)


def _pictures(image: Array, reference: Array, decades: Array) -> tuple[tuple[bytes, str], ...]:
    scale = 0.7 / max(
        float(np.quantile(reference[reference > 0], 0.99)) if (reference > 0).any() else 1.0, 1e-9
    )
    difference = (image - reference).mean(axis=-1)
    limit = max(float(np.quantile(np.abs(difference), 0.995)), 1e-12)
    power = max(float(np.sqrt((reference**2).mean())), 1e-12)
    return (
        (_enlarged(image * scale), "image"),
        (_enlarged(reference * scale), "reference"),
        (
            error_map(
                difference / power, label="difference / RMS of reference", limit=limit / power, signed=True
            ),
            "difference, relative",
        ),
        (error_map(decades, label="-log10 p of the pixel", limit=_CLEAREST), "p-values, in decades"),
    )


def _enlarged(image: Array) -> bytes:
    return png_bytes(show_linear(np.maximum(image, 0.0).repeat(_ENLARGED, axis=0).repeat(_ENLARGED, axis=1)))
