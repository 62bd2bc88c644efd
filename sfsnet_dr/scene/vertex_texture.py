"""A per-vertex colour as the reflectance of BSDFs that need its mean, which ``mesh_attribute`` lacks."""

from __future__ import annotations

from typing import Any, Final

from sfsnet_dr.scene.jit import mi

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
