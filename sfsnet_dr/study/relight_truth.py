"""How far relit faces are from path-traced ones under the same lights, and why.

Noise is in no number: an error is a mean product of two differences, each of a relit image and a reference
that share no random number with the other pair.

The same light means: after hard lights were moved to, or softened away from, the directions that a face has
responses to, as all lights of the datasets are (``scene.light_sources``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.data.relight import Mixture, mixture, relight_scene
from sfsnet_dr.render.capture import Capture, CaptureOptions, capture
from sfsnet_dr.render.reference import path_trace
from sfsnet_dr.scene.equirect import MAP_SIZE
from sfsnet_dr.scene.face import sample_face
from sfsnet_dr.scene.light_sources import sample_direction, sample_scene_light
from sfsnet_dr.scene.light_spec import LightKind, LightSpec
from sfsnet_dr.scene.lights import MAP_ORDER, SceneLight
from sfsnet_dr.scene.mesh import Mesh
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.spec import CameraSpec, SceneSpec
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.projection import equirect_directions

Array = npt.NDArray[np.float64]

#: Kinds of light, one a face each; maps of files where the scene names a folder.
KINDS: Final[tuple[LightKind, ...]] = ("hdr", "sun_sky", "studio", "directional", "ambient")

#: What is measured, in the order of ``FaceErrors.squared``: the whole error, its causes, and the noise of one
#: relit image. ``truncation`` is light beyond order 4, ``bounces`` light over further surface points than are
#: traced, ``gloss`` the mirror image of the light of order 4 held by order 2, ``rest`` everything else.
PARTS: Final = ("total", "truncation", "bounces", "gloss", "rest", "noise")

_DIRECTIONS, _LIGHT = 17, 18  # random streams


@dataclass(frozen=True, eq=False)
class _View:
    """What stays while lights change: a face, the camera, the seed of the noise."""

    mesh: Mesh
    camera: CameraSpec
    seed: int

    def black(self) -> _View:
        """The face with a black body: nothing but gloss is left."""
        return replace(self, mesh=replace(self.mesh, albedo=np.zeros_like(self.mesh.albedo)))


@dataclass(frozen=True, eq=False)
class FaceErrors:
    """One face under its lights.

    Attributes:
        squared: (lights, len(PARTS)) squared errors relative to the mean square of the path-traced image over
            the face. Unbiased estimates: they may be negative. The causes' need not sum to the total's.
        relit, traced: (lights, H, W, 3) the two images, linear.
        coverage: (H, W).
    """

    squared: Array
    relit: npt.NDArray[np.float32]
    traced: npt.NDArray[np.float32]
    coverage: npt.NDArray[np.float32]


class Studio:
    """Scenes by what lights them, each built once and given every face in turn."""

    def __init__(self, gloss: bool) -> None:
        self._gloss = gloss
        self._scenes: dict[tuple[bool, int], SurfaceScene] = {}
        self._shown: dict[tuple[bool, int], Mesh] = {}

    def place(self, view: _View, light: SceneLight) -> SurfaceScene:
        """A scene with a face, a camera and a light."""
        mesh, camera = view.mesh, view.camera
        key = (light.environment is not None, len(light.directional))
        scene = self._scenes.get(key)
        if scene is None or not scene.fits(mesh, camera):
            scene = SurfaceScene(mesh, camera, light.directional, environment=key[0], gloss=self._gloss)
        else:
            scene.set_camera(camera)
            scene.set_directional(light.directional)
            if self._shown[key] is not mesh:
                scene.set_mesh(mesh)
        self._scenes[key], self._shown[key] = scene, mesh
        if light.environment is not None:
            scene.set_environment(light.environment)
        return scene


class RelitFaces:
    """Measures faces one after another.

    Args:
        spec: of the faces; ``sampling.reference`` is the paths per pixel of each reference.
        kinds: a light of each is drawn for every face.
    """

    def __init__(self, spec: SceneSpec, kinds: Sequence[LightKind]) -> None:
        self._spec, self._kinds = spec, kinds
        self._whole, self._mirror = Studio(spec.has_gloss), Studio(True)

    def measure(self, seed: int) -> FaceErrors:
        """The face of a seed."""
        spec, face = self._spec, sample_face(seed, self._spec)
        view = _View(face.mesh, face.pose.camera(spec.camera), seed)
        directions = _directions(seed, spec.sampling.directions)
        options = CaptureOptions(MAP_ORDER, spec.sampling.bounces, spec.sampling.paths)
        scene = self._whole.place(view, SceneLight("white", np.ones((*MAP_SIZE, 3))))
        pair = [capture(scene, spec.sampling.transport, 2 * seed + k, options, directions) for k in range(2)]
        black, found = view.black(), []
        for number, kind in enumerate(KINDS):
            if kind in self._kinds:
                rng = np.random.default_rng((seed, _LIGHT, number))
                light = _light(spec.light, kind, rng, directions)
                found.append(self._measure(pair, directions, light, view, black))
        squared, relit, traced = (np.stack(column) for column in zip(*found, strict=True))
        return FaceErrors(squared, relit.astype(np.float32), traced.astype(np.float32), pair[0].coverage)

    def _measure(
        self, pair: Sequence[Capture], directions: Array, light: SceneLight, view: _View, black: _View
    ) -> tuple[Array, Array, Array]:
        """Squared errors (len(PARTS),) under one light, and the two images."""
        weights, depth = mixture(light, directions, MAP_ORDER), self._spec.sampling.bounces + 2
        relit = [relight_scene(maps.transport, maps.gloss, maps.lamps, weights) for maps in pair]
        traced, cut = (self._trace(self._whole, view, light, end) for end in (-1, depth))
        smooth, gloss, mirror = cut, [np.zeros_like(relit[0])] * 2, [np.zeros_like(relit[0])] * 2
        if light.environment is not None:
            smooth = self._trace_smooth(self._whole, view, light, depth)
            if self._spec.has_gloss:
                gloss = [_gloss(maps, weights) for maps in pair]
                mirror = self._trace_smooth(self._mirror, black, replace(light, directional=()), 2)
        inside = pair[0].mask > 0

        def squared(one: Sequence[Array], other: Sequence[Array]) -> float:
            return float(((one[0] - other[0]) * (one[1] - other[1]))[inside].mean())

        found = {
            "total": squared(relit, traced),
            "truncation": squared(smooth, cut),
            "bounces": squared(cut, traced),
            "gloss": squared(gloss, mirror),
            "rest": squared(_less(relit, gloss), _less(smooth, mirror)),
            "noise": float(((relit[0] - relit[1]) ** 2)[inside].mean()) / 2,
        }
        power = float((traced[0] * traced[1])[inside].mean())
        return np.array([found[part] for part in PARTS]) / power, relit[0], (traced[0] + traced[1]) / 2

    def _trace(self, studio: Studio, view: _View, light: SceneLight, depth: int) -> list[Array]:
        """Two images of independent noise; other lights and depths share it as far as paths are the same."""
        scene, samples = studio.place(view, light), self._spec.sampling.reference
        return [path_trace(scene, samples, 2 * view.seed + k, depth).mean for k in range(2)]

    def _trace_smooth(self, studio: Studio, view: _View, light: SceneLight, depth: int) -> list[Array]:
        """The same with the environment's expansion in place of the environment.

        Where the expansion is negative it is no light: there its opposite is traced and taken away.
        """
        texels = sh_basis(equirect_directions(*MAP_SIZE), MAP_ORDER)
        expansion = texels @ light.environment_coefficients(MAP_ORDER).values
        images = self._trace(studio, view, replace(light, environment=np.maximum(expansion, 0.0)), depth)
        if expansion.min() < 0:
            below = SceneLight("negative", np.maximum(-expansion, 0.0))
            images = _less(images, self._trace(studio, view, below, depth))
        return images


def _directions(seed: int, count: int) -> Array:
    rng = np.random.default_rng((seed, _DIRECTIONS))
    return np.array([sample_direction(rng) for _ in range(count)]).reshape(-1, 3)


def _light(spec: LightSpec, kind: LightKind, rng: np.random.Generator, directions: Array) -> SceneLight:
    only = {name: float(name == kind) for name in (*KINDS, "lobes")}
    return sample_scene_light(rng, replace(spec, **only), directions)  # type: ignore[arg-type]


def _gloss(maps: Capture, weights: Mixture) -> Array:
    """What the relit image holds of the light's mirror image."""
    return np.asarray(np.einsum("khw,kc->hwc", maps.gloss, weights.radiance[: len(maps.gloss)]))


def _less(images: Sequence[Array], others: Sequence[Array]) -> list[Array]:
    return [image - other for image, other in zip(images, others, strict=True)]
