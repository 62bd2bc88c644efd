"""Which lights a family of scenes has; part of its specification."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, Literal, get_args

from sfsnet_dr.core.config import added_field
from sfsnet_dr.core.errors import InputError

LightKind = Literal["hdr", "sun_sky", "studio", "directional", "ambient", "lobes", "fitted"]

#: All kinds; ``LightSpec`` has a weight of the same name for each.
LIGHT_KINDS: Final[tuple[LightKind, ...]] = get_args(LightKind)


@dataclass(frozen=True)
class LightSpec:
    """How often each kind of light is drawn, as weights of at least 0, and how a camera takes it.

    Attributes:
        hdr: environment maps of ``environments``; without a folder this weight does not count.
        sun_sky: sun and sky by Mitsuba's ``sunsky``.
        studio: panels of light in a dim room.
        directional: one to three lamps up to 85 degrees from the viewer's direction, over a dim dome.
        ambient: a dome without a direction but for a vertical gradient.
        lobes: soft lobes over a dome (``sh.priors``).
        fitted: soft lights as photographs have them (``scene.fitted_light``).
        light_prior_file: file that `sfsnet-dr fit-light-prior` wrote, to draw those from; left out, the
            package's own.
        environments: folder of environment maps (.exr, .hdr).
        exposure: range of the luminance of a white face's mean shading, spread evenly in its logarithm.
        white_balance: range of the share of the light's tint that the camera's white balance takes away.
    """

    RENAMED: ClassVar[dict[str, str]] = {"mixture": "light_prior_file"}

    hdr: float = 0.3
    sun_sky: float = 0.15
    studio: float = 0.25
    directional: float = 0.25
    ambient: float = 0.05
    lobes: float = 0.0
    environments: str | None = None
    exposure: tuple[float, float] = (0.5, 1.2)
    white_balance: tuple[float, float] = (0.6, 1.0)
    fitted: float = added_field(0.0)
    light_prior_file: str | None = added_field(None)

    def weights(self) -> dict[LightKind, float]:
        """Kinds with a weight above 0 that can be drawn.

        Raises:
            InputError: if there are none.
        """
        every: dict[LightKind, float] = {kind: float(getattr(self, kind)) for kind in LIGHT_KINDS}
        if self.environments is None:
            every["hdr"] = 0.0
        chosen = {kind: weight for kind, weight in every.items() if weight > 0}
        if not chosen:
            raise InputError(
                "light: no kind of light has a weight above 0 (hdr needs light.environments too)"
            )
        return chosen

    def limits(self) -> dict[str, tuple[float, float, float]]:
        """Value and allowed range of every number, by key."""
        found: dict[str, tuple[float, float, float]] = {
            name: (float(getattr(self, name)), 0.0, 1e6) for name in LIGHT_KINDS
        }
        found |= {f"exposure[{k}]": (value, 0.01, 10.0) for k, value in enumerate(self.exposure)}
        return found | {
            f"white_balance[{k}]": (value, 0.0, 1.0) for k, value in enumerate(self.white_balance)
        }
