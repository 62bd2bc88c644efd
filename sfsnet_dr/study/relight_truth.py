"""How far relit faces are from path-traced ones under the same lights, and why.

Noise is in neither number: the error is a mean product of two differences, each of a relit image and a
reference that share no random number with the other pair.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from sfsnet_dr.data.relight import mixture, relight_scene
from sfsnet_dr.metrics.bootstrap import interval
from sfsnet_dr.render.capture import Capture, CaptureOptions, capture
from sfsnet_dr.render.reference import path_trace
from sfsnet_dr.report.record import Record, measured
from sfsnet_dr.scene.face import sample_face
from sfsnet_dr.scene.light_sources import sample_direction, sample_scene_light
from sfsnet_dr.scene.light_spec import LightKind, LightSpec
from sfsnet_dr.scene.lights import MAP_ORDER, SceneLight
from sfsnet_dr.scene.mesh import Mesh
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.spec import CameraSpec, SceneSpec

Array = npt.NDArray[np.float64]

#: Kinds of light, one a face each; maps of files where the scene names a folder.
KINDS: tuple[LightKind, ...] = ("hdr", "sun_sky", "studio", "directional", "ambient")

_DIRECTIONS, _LIGHT = 17, 18  # random streams


@dataclass(frozen=True)
class Errors:
    """Squared errors of one face under one light, relative to the mean square of the reference.

    Unbiased estimates: they may be negative.

    Attributes:
        total: of the relit image, its noise left out.
        bounces: of leaving out all surface points after the last.
        gloss: of the mirror image of the environment, held by order 2.
        noise: variance of one relit image.
    """

    total: float
    bounces: float
    gloss: float
    noise: float

    @property
    def rest(self) -> float:
        """What is left: an environment held by order 4, and lamps up to 2 degrees from their response."""
        return self.total - self.bounces - self.gloss


class Studio:
    """Scenes by what lights them, each built once and given every face in turn."""

    def __init__(self, gloss: bool) -> None:
        self._gloss = gloss
        self._scenes: dict[tuple[bool, int], SurfaceScene] = {}

    def place(self, mesh: Mesh, camera: CameraSpec, light: SceneLight) -> SurfaceScene:
        """A scene with a mesh, a camera and a light."""
        key = (light.environment is not None, len(light.directional))
        scene = self._scenes.get(key)
        if scene is None or not scene.fits(mesh, camera):
            scene = self._scenes[key] = SurfaceScene(
                mesh, camera, light.directional, environment=key[0], gloss=self._gloss
            )
        else:
            scene.set_camera(camera)
            scene.set_mesh(mesh)
            scene.set_directional(light.directional)
        if light.environment is not None:
            scene.set_environment(light.environment)
        return scene


def relight_truth(
    spec: SceneSpec,
    *,
    faces: int = 20,
    kinds: Sequence[LightKind] = KINDS,
    seed: int = 0,
    command: str = "sfsnet-dr bench relight",
    say: Callable[[str], None] = lambda line: None,
) -> list[Record]:
    """Measure relit images against the path tracer.

    Args:
        spec: of the faces; ``sampling.reference`` is the paths per pixel of each of the references. Kind
            ``"hdr"`` needs ``light.environments`` and is left out without.
        faces: how many, from ``seed`` on.
        kinds: a light of each is drawn for every face.
        seed: of the first face.
        command: what the records say measured them.
        say: is told what is going on.

    Returns:
        ``relight.rel_rmse`` over all faces and lights with an interval over faces, each kind's alone, and the
        share of each cause.
    """
    kinds = [kind for kind in kinds if kind != "hdr" or spec.light.environments is not None]
    studio, mirrors = Studio(spec.has_gloss), Studio(True)
    found: dict[LightKind, list[Errors]] = {kind: [] for kind in kinds}
    for face_seed in range(seed, seed + faces):
        for kind, errors in _measure_face(spec, face_seed, kinds, studio, mirrors).items():
            found[kind].append(errors)
        say(f"face {face_seed}: {_root(np.mean([found[kind][-1].total for kind in kinds])):.4f}")
    return _records(found, command, seed)


def _measure_face(
    spec: SceneSpec, seed: int, kinds: Sequence[LightKind], studio: Studio, mirrors: Studio
) -> dict[LightKind, Errors]:
    face, sampling = sample_face(seed, spec), spec.sampling
    camera = face.pose.camera(spec.camera)
    rng = np.random.default_rng((seed, _DIRECTIONS))
    directions = np.array([sample_direction(rng) for _ in range(sampling.directions)]).reshape(-1, 3)
    options = CaptureOptions(MAP_ORDER, sampling.bounces, sampling.paths)
    ambient = SceneLight("any", np.ones((64, 128, 3)))
    scene = studio.place(face.mesh, camera, ambient)
    pair = [capture(scene, sampling.transport, 2 * seed + k, options, directions) for k in range(2)]
    black = replace(face.mesh, albedo=np.zeros_like(face.mesh.albedo))
    found = {}
    for number, kind in enumerate(kinds):
        light = _light(spec.light, kind, np.random.default_rng((seed, _LIGHT, number)), directions)
        lit = studio.place(face.mesh, camera, light)
        mirror = None
        if spec.has_gloss and light.environment is not None:
            mirror = mirrors.place(black, camera, replace(light, directional=()))
        found[kind] = _measure(spec, pair, directions, light, lit, mirror, 4 * seed)
    return found


def _light(spec: LightSpec, kind: LightKind, rng: np.random.Generator, directions: Array) -> SceneLight:
    only = {name: float(name == kind) for name in (*KINDS, "lobes")}
    return sample_scene_light(rng, replace(spec, **only), directions)  # type: ignore[arg-type]


def _measure(
    spec: SceneSpec,
    pair: Sequence[Capture],
    directions: Array,
    light: SceneLight,
    lit: SurfaceScene,
    mirror: SurfaceScene | None,
    seed: int,
) -> Errors:
    weights, sampling = mixture(light, directions, MAP_ORDER), spec.sampling
    relit = [relight_scene(maps.transport, maps.gloss, maps.lamps, weights) for maps in pair]
    truth = [path_trace(lit, sampling.reference, seed + k).mean for k in range(2)]
    cut = [path_trace(lit, sampling.reference, seed + 2 + k, sampling.bounces + 2).mean for k in range(2)]
    inside = pair[0].mask > 0
    power = float((truth[0] * truth[1])[inside].mean())

    def squared(one: Sequence[Array], other: Sequence[Array]) -> float:
        return float(((one[0] - other[0]) * (one[1] - other[1]))[inside].mean()) / power

    gloss = 0.0
    if mirror is not None:
        image = [np.einsum("khw,kc->hwc", maps.gloss, weights.radiance[: len(maps.gloss)]) for maps in pair]
        seen = [path_trace(mirror, sampling.reference, seed + k, 2).mean for k in range(2)]
        gloss = squared(image, seen)
    noise = float(((relit[0] - relit[1]) ** 2)[inside].mean()) / 2 / power
    return Errors(squared(relit, truth), squared(cut, truth), gloss, noise)


def _records(found: dict[LightKind, list[Errors]], command: str, seed: int) -> list[Record]:
    every = {field.name: _table(found, field.name) for field in fields(Errors)}
    every["rest"] = _table(found, "rest")
    total = every["total"].mean(axis=1)
    low, high = interval(total, np.mean, seed=seed) if len(total) > 1 else (total[0], total[0])
    records = [
        measured(
            "relight.rel_rmse",
            _root(total.mean()),
            "1",
            command=command,
            interval=(_root(low), _root(high)),
            seed=seed,
        )
    ]
    values = {f"relight.{kind}.rel_rmse": every["total"][:, k].mean() for k, kind in enumerate(found)}
    values |= {f"relight.cause.{cause}": every[cause].mean() for cause in ("bounces", "gloss", "rest")}
    values["relight.noise"] = every["noise"].mean()
    return records + [
        measured(what, _root(value), "1", command=command, seed=seed) for what, value in values.items()
    ]


def _table(found: dict[LightKind, list[Errors]], name: str) -> Array:
    """(faces, kinds)."""
    return np.array([[getattr(errors, name) for errors in column] for column in found.values()]).T


def _root(squared: float | np.floating) -> float:
    """0 where an unbiased estimate of a square is negative."""
    return float(np.sqrt(max(float(squared), 0.0)))
