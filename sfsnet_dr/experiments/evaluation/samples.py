"""Photographs to measure methods on, whatever is known of them: one form for all data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt
from torch import Tensor

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.databases.base import Listing

Array = npt.NDArray[np.float64]

#: Linear values below and above which a photograph says little about the skin behind them.
DARK: Final = 0.02
SATURATED: Final = 0.98


@dataclass(frozen=True, eq=False)
class EvaluationSample:
    """One photograph in the canonical frame, S pixels wide, and its truth as far as it is known.

    Attributes:
        name: of the file.
        subject: whom it shows.
        capture: photographs of one capture show one face in one pose under several lights.
        image: linear, (3, S, S).
        mask: share of each pixel that is skin, (1, S, S).
        shown: share of each pixel that a picture of it shows, (S, S); the rest is white.
        grey: whether the photograph has no colour.
        light: name of its light, empty if it has none.
        direction: unit vector toward its only light.
        coefficients: shading coefficients of its light, 27.
        normal: (3, S, S).
        albedo: (3, S, S), up to a factor.
        sure: where the truth's own confidence is high, (S, S) of bool; None where no confidence is known.
        causes: what may make it hard, by name, for the explanation of large errors; percent of the skin where
            nothing else is said.
    """

    name: str
    subject: str
    capture: str
    image: Tensor
    mask: Tensor
    shown: Array
    grey: bool = False
    light: str = ""
    direction: Array | None = None
    coefficients: Array | None = None
    normal: Tensor | None = None
    albedo: Tensor | None = None
    sure: npt.NDArray[np.bool_] | None = None
    causes: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Collection:
    """Photographs of one kind of data.

    Attributes:
        data: its name, the first word of records.
        shots: at least one.
        truth: where the truth comes from, as a sentence for readers.
        few: names of the lights of the 19-way classification.
        skipped: files, captures and subjects that are not in it, with the reason.
        listing: the photographs before they were read, if that is where they come from.

    Raises:
        InputError: if there is nothing to measure.
    """

    data: str
    shots: Sequence[EvaluationSample]
    truth: str
    few: tuple[str, ...] = ()
    skipped: Mapping[str, str] = field(default_factory=dict)
    listing: Listing | None = None

    def __post_init__(self) -> None:
        if not self.shots:
            name, why = next(iter(self.skipped.items()), (self.data, "nothing found"))
            raise InputError(f"{name}: {why}; no photograph is left to measure")

    @property
    def subjects(self) -> list[str]:
        """Who is in it, in order."""
        return sorted({shot.subject for shot in self.shots})


def picture_causes(image: Tensor, mask: Tensor) -> dict[str, float]:
    """What any picture tells: shares of its skin that are dark and that are saturated, percent."""
    values = image.numpy()[:, mask[0].numpy() > 0.5]
    dark = np.tensordot(LUMINANCE, values, 1) < DARK
    return {"dark": 100 * float(dark.mean()), "saturated": 100 * float((values.max(0) >= SATURATED).mean())}


def spread_out(count: int, most: int) -> list[int]:
    """Places of ``most`` of ``count`` things, evenly over all; all of them if there are no more."""
    if count <= most:
        return list(range(count))
    return [int(place) for place in (np.arange(most) + 0.5) * count / most]
