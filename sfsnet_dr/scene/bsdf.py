"""The BSDF of skin: two glossy lobes (``roughplastic``) over a body with per-vertex reflectance.

What a mesh calls albedo is what its body reflects through the interface, seen straight on in light from all
sides: that is what skin optics gives and what photographs show. Mitsuba's parameter is the reflectance under
the interface; ``body_share`` is the ratio of the two, 0.59 for the dull and 0.79 for the shiny lobe.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.scene.jit import dr, mi

Array = npt.NDArray[np.float64]

#: Index of refraction of the interface, and the GGX roughness of its dull and its shiny lobe.
SURFACE_IOR: Final = 1.4
DULL_ALPHA: Final = 0.45
SHINY_ALPHA: Final = 0.2

#: Nodes of Mitsuba's table of the transmittance of a rough interface over the cosine.
NODES: Final = 64

_WHITE = {"type": "rgb", "value": [1.0, 1.0, 1.0]}
_BANDS = 9


def lobe(alpha: float, reflectance: dict[str, Any]) -> dict[str, Any]:
    """The plugin's description, for one roughness and the reflectance under the interface."""
    return {
        "type": "roughplastic",
        "distribution": "ggx",
        "alpha": alpha,
        "int_ior": SURFACE_IOR,
        "nonlinear": False,
        "diffuse_reflectance": reflectance,
    }


@cache
def relative_ior() -> float:
    """Index of refraction against air, as Mitsuba has it."""
    return float(np.ravel(mi.traverse(mi.load_dict(lobe(DULL_ALPHA, _WHITE)))["eta"])[0])


@cache
def nodes() -> Array:
    """(64, 2) square root of (diffuse scattering times pi, of a white body) over the cosine, both lobes.

    Scattering is a product of equal functions of both cosines; Mitsuba has them as straight lines between
    these nodes.
    """
    cosine = np.concatenate([[0.5 / (NODES - 1)], np.arange(1, NODES) / (NODES - 1)])
    lines = [_root(alpha, cosine) for alpha in (DULL_ALPHA, SHINY_ALPHA)]
    # Nothing is scattered at the cosine 0 itself: its node follows from the middle of the first line.
    return np.stack([np.concatenate([[2 * line[0] - line[1]], line[1:]]) for line in lines], axis=1)


@cache
def kernels() -> Array:
    """(9, 2) zonal coefficients of (nodes' function times clamped cosine over pi), both lobes.

    Exact for straight lines: Gauss and Legendre's rule with 8 points on each of them.
    """
    edges, values = np.arange(NODES) / (NODES - 1), nodes()
    points, weights = np.polynomial.legendre.leggauss(8)
    part = (points[:, None] + 1) / 2
    cosine = edges[:-1, None] + part[:, 0] / (NODES - 1)
    lines = values[:-1, None] + part * np.diff(values, axis=0)[:, None]
    weight = weights / 2 / (NODES - 1) * 2.0 * cosine
    legendre = np.stack([np.polynomial.Legendre.basis(band)(cosine) for band in range(_BANDS)])
    return np.asarray(np.einsum("ij,lij,ija->la", weight, legendre, lines))


def body_share(mix: Array) -> Array:
    """Reflected share, seen straight on in light from all sides, of the reflectance under the interface.

    Args:
        mix: share of the shiny lobe, in [0, 1], any shape.
    """
    dull, shiny = nodes()[-1] * kernels()[0]
    return np.asarray(dull + (shiny - dull) * np.asarray(mix, dtype=np.float64))


def _root(alpha: float, cosine: Array) -> Array:
    """The function at cosines, read off Mitsuba's BSDF where both directions have the same one."""
    bsdf, hit = mi.load_dict(lobe(alpha, _WHITE)), dr.zeros(mi.SurfaceInteraction3f, len(cosine))
    hit.wi = mi.Vector3f(np.sqrt(1.0 - cosine**2), np.zeros_like(cosine), cosine)
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.Diffuse
    value = np.asarray(bsdf.eval(context, hit, hit.wi), dtype=np.float64)[0]
    return np.asarray(np.sqrt(value * np.pi / cosine))


#: Name of the plugin; registered when this file is imported.
PLUGIN: Final = "vertex_reflectance"

#: The mean that is reported, that of a middle skin. It only sets the share of samples that a BSDF spends on
#: its glossy lobe (an eighth at normal incidence), never what it reflects.
_MEAN = 0.3


class VertexReflectance(mi.Texture):  # type: ignore[misc]
    """Mitsuba's ``mesh_attribute`` with a mean.

    Args:
        properties: ``name``, the attribute's, such as ``vertex_color``.
    """

    def __init__(self, properties: mi.Properties) -> None:
        super().__init__(properties)
        self._attribute = mi.load_dict({"type": "mesh_attribute", "name": properties["name"]})

    def eval(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Color3f:
        """The colour at an interaction."""
        return self._attribute.eval(si, active)

    def mean(self) -> mi.Float:
        """A constant: what it steers is explained above."""
        return mi.Float(_MEAN)

    def is_spatially_varying(self) -> bool:
        """Always."""
        return True

    def to_string(self) -> str:
        """A short description."""
        return f"VertexReflectance[{self._attribute}]"


def _make(properties: Any) -> VertexReflectance:
    return VertexReflectance(properties)


mi.register_texture(PLUGIN, _make)
