"""What a renderer is: the protocol by which ours and other people's join validation and regression."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.subject import Subject

Image = npt.NDArray[np.floating]


@dataclass(frozen=True)
class Capabilities:
    """What a renderer accounts for; what it leaves out it ignores, as a model does.

    Attributes:
        visibility: cast shadows.
        bounces: surface points that light may meet after the first; 0 is direct light, -1 has no limit.
        gloss: the glossy lobes of a subject that has them.
        noisy: whether the image is made of as many random samples as the budget allows.
        order: highest SH band of the light that counts, as in a shading model; None for all of the light.
    """

    visibility: bool
    bounces: int = 0
    gloss: bool = False
    noisy: bool = False
    order: int | None = None


@dataclass(frozen=True)
class Budget:
    """What a noisy renderer may spend; others need not look at it.

    Attributes:
        samples: paths per pixel.
        seed: two seeds give independent images, the same seed the same image. Models that are not noisy may
            yet place by it the rays that their maps are made with.
    """

    samples: int = 64
    seed: int = 0


class Renderer(Protocol):
    """A renderer of subjects under lights.

    Attributes:
        name: a short word for records and tables, such as ``torch-order2``.
        capabilities: what it accounts for.
    """

    name: str
    capabilities: Capabilities

    def render(self, subject: Subject, light: Light, budget: Budget) -> Image:
        """An image (H, W, 3), float32 or float64, of the subject under the light.

        Linear Rec. 709 radiance under a box filter, row 0 at the top; 0 where the surface is not seen, and
        the surface's share alone where it covers a part of a pixel.
        """
        ...
