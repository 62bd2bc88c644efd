"""Studios: panels of light, round or rectangular, in a room of its own colour, as an environment map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.sh.projection import equirect_directions

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Panel:
    """An area light, as the subject sees it.

    Attributes:
        direction: (3,) unit vector toward its middle.
        half_size: half its width and height, degrees, below 80.
        roll: degrees by which it is turned about its middle.
        soft: degrees over which its edge fades, at least one texel (3), or the map would show steps.
        radiance: (3,) linear, at its middle.
        round: an ellipse instead of a rectangle.
    """

    direction: Array
    half_size: tuple[float, float]
    roll: float
    soft: float
    radiance: Array
    round: bool

    def at(self, directions: Array) -> Array:
        """Radiance (..., 3) from unit directions (..., 3)."""
        across, along = self._axes()
        depth = directions @ self.direction
        x = np.degrees(np.arctan2(directions @ across, depth)) / self.half_size[0]
        y = np.degrees(np.arctan2(directions @ along, depth)) / self.half_size[1]
        reach = np.hypot(x, y) if self.round else np.maximum(np.abs(x), np.abs(y))
        softness = self.soft / min(self.half_size)
        cover = np.clip((1 - reach) / softness + 0.5, 0.0, 1.0)
        return np.asarray(np.where(depth > 0, cover**2 * (3 - 2 * cover), 0.0)[..., None] * self.radiance)

    def _axes(self) -> tuple[Array, Array]:
        aside = np.cross(
            [0.0, 1.0, 0.0] if abs(self.direction[1]) < 0.99 else [0.0, 0.0, 1.0], self.direction
        )
        aside /= np.linalg.norm(aside)
        up = np.cross(self.direction, aside)
        a = np.radians(self.roll)
        return np.cos(a) * aside + np.sin(a) * up, np.cos(a) * up - np.sin(a) * aside


def studio_environment(panels: tuple[Panel, ...], walls: Array, floor: Array) -> Array:
    """Environment map (64, 128, 3) of panels before walls.

    Args:
        panels: where two overlap, their light adds.
        walls, floor: (3,) radiance of the room at and above the horizon, and straight below.
    """
    directions = equirect_directions(*MAP_SIZE)
    below = np.clip(-directions[..., 1:2], 0.0, 1.0)
    room = walls * (1 - below) + floor * below
    return np.asarray(room + sum(panel.at(directions) for panel in panels))
