"""Who a face belongs to, as far as skin, hair and wrinkles depend on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

#: Typology angles of the sampled skin tones, degrees: from dark to very light, evenly.
TONE_RANGE: Final = (-52.0, 60.0)
AGE_RANGE: Final = (18.0, 85.0)


@dataclass(frozen=True)
class Person:
    """Traits that shape and surface share.

    Attributes:
        tone: individual typology angle of the skin, degrees (see ``skin_color.typology_angle``).
        male: 0 for a woman, 1 for a man, continuous between.
        age: years.
    """

    tone: float
    male: float
    age: float

    @staticmethod
    def sample(rng: np.random.Generator) -> Person:
        """A random adult: tones evenly over the typology angle, more young than old."""
        low, high = AGE_RANGE
        return Person(
            tone=float(rng.uniform(*TONE_RANGE)),
            male=float(rng.beta(0.5, 0.5)),
            age=float(low + (high - low) * rng.beta(0.9, 1.8)),
        )

    @property
    def darkness(self) -> float:
        """0 for the lightest tone, 1 for the darkest."""
        low, high = TONE_RANGE
        return float(np.clip((high - self.tone) / (high - low), 0.0, 1.0))

    @property
    def wear(self) -> float:
        """0 below 28 years, 1 at 80: how far wrinkles, spots and grey hair have come."""
        return float(np.clip((self.age - 28.0) / 52.0, 0.0, 1.0))
