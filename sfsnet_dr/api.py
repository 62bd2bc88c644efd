"""The functions of ``import sfsnet_dr as sf`` that join several rooms: scenes by name, images, relighting.

Other public names are those of the rooms themselves; ``sfsnet_dr/__init__.pyi`` lists all of them.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.core.conventions import LIGHT_ORDER
from sfsnet_dr.core.errors import InputError, check_shape, nearest
from sfsnet_dr.scene import subject as subjects
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.lights.spec import LIGHT_KINDS, LightSpec
from sfsnet_dr.scene.spec import SceneSpec
from sfsnet_dr.scene.spec import load_scene as read_scene
from sfsnet_dr.scene.subject import Subject
from sfsnet_dr.sh.coefficients import Radiance, Shading

if TYPE_CHECKING:
    from torch import Tensor

    from sfsnet_dr.data.bundle import Bundle
    from sfsnet_dr.inference.outputs import Decomposition
    from sfsnet_dr.render.aovs import TransportMaps
    from sfsnet_dr.render.path_tracer import Reference
    from sfsnet_dr.render.transport_shading import Transport
    from sfsnet_dr.report.record import Record

Array = NDArray[np.float64]
Image = TypeVar("Image", NDArray[np.floating[Any]], "Tensor")


def load_scene(scene: Path | str, *, model_path: Path | str | None = None) -> SceneSpec:
    """Read a scene: the specification of a surface, its camera and its sampling.

    Args:
        scene: a TOML file, or the name of a validation scene such as ``"head"`` or ``"sphere"``.
        model_path: where the scene's face model lies, in place of what the file says.

    Returns:
        The specification, a frozen dataclass; ``dataclasses.replace`` changes it.

    Raises:
        InputError: for an unknown name, a missing file, or a key or value that is not allowed.

    Example:
        >>> import sfsnet_dr as sf
        >>> sf.load_scene("sphere").shape
        'sphere'
    """
    spec = read_scene(subjects.find_scene(scene))
    return spec if model_path is None else replace(spec, model_path=str(model_path))


def build_subject(scene: SceneSpec | Path | str, seed: int = 0) -> Subject:
    """Build the surface that a scene describes, before its camera.

    Args:
        scene: a specification, a TOML file, or the name of a validation scene.
        seed: of a head's identity, expression, pose, skin and camera; other shapes do not depend on it.

    Returns:
        The mesh (``.mesh``) and the camera (``.camera``).

    Raises:
        InputError: as ``load_scene``, or for a missing or damaged face model.

    Example:
        >>> import sfsnet_dr as sf
        >>> sf.build_subject("sphere").camera.size
        128
    """
    return subjects.build_subject(scene if isinstance(scene, SceneSpec) else load_scene(scene), seed)


def sample_light(
    seed: int | np.random.Generator = 0,
    kind: str | None = None,
    *,
    environments: Path | str | None = None,
    spec: LightSpec | None = None,
) -> Light:
    """Draw a light as photographs have them, exposed and white-balanced as by a camera.

    Args:
        seed: a seed, or a generator to draw from.
        kind: one of ``LIGHT_KINDS``; left out, a mixture of all.
        environments: folder of environment maps (.exr, .hdr) for kind ``"hdr"``.
        spec: weights of the kinds and ranges of exposure and white balance; the defaults if left out.

    Returns:
        A light whose mean shading on a white face lies between 0.5 and 1.2, or as ``spec.exposure`` says.

    Raises:
        InputError: for an unknown kind, or ``"hdr"`` without a folder of maps.

    Example:
        >>> import sfsnet_dr as sf
        >>> sf.sample_light(3, "studio").name
        'studio'
    """
    from sfsnet_dr.scene.lights.sampling import sample_scene_light

    spec = spec or LightSpec()
    if environments is not None:
        spec = replace(spec, environments=str(environments))
    if kind is not None:
        if kind not in LIGHT_KINDS:
            raise InputError(f"kind: {kind!r} found; {nearest(kind, LIGHT_KINDS)}")
        only: dict[str, Any] = {name: float(name == kind) for name in LIGHT_KINDS}
        spec = replace(spec, **only)
    rng = seed if isinstance(seed, np.random.Generator) else np.random.default_rng(seed)
    return sample_scene_light(rng, spec)


def path_trace(
    subject: Subject, light: Light, *, samples: int = 64, seed: int = 0, max_bounces: int = -1
) -> Reference:
    """Render an unbiased image with full light transport, by Mitsuba 3.

    Args:
        subject: of ``build_subject``.
        light: what lights it.
        samples: paths per pixel, at least 2.
        seed: two seeds give independent images, one seed the same image.
        max_bounces: surface points that light may meet after the first; 0 is direct light, -1 has no limit.

    Returns:
        ``.mean`` (H, W, 3) linear Rec. 709 radiance, 0 beside the surface, ``.variance`` of that mean, and
        ``.samples``.

    Raises:
        InputError: for fewer than 2 samples.

    Example:
        >>> import sfsnet_dr as sf
        >>> image = sf.path_trace(sf.build_subject("sphere"), sf.Light.from_environment(1.0), samples=4)
        >>> image.mean.shape
        (128, 128, 3)
    """
    from sfsnet_dr.render.path_tracer import path_trace as trace
    from sfsnet_dr.render.renderers.mitsuba import show_subject

    depth = -1 if max_bounces < 0 else max_bounces + 2
    return trace(show_subject(subject, light), samples, seed, depth)


def render_aovs(
    subject: Subject,
    *,
    samples: int = 16,
    seed: int = 0,
    order: int = 4,
    max_bounces: int = 3,
    paths: int = 4,
    directions: NDArray[np.floating[Any]] | None = None,
) -> TransportMaps:
    """Render ground truth: normals, albedo, mask, regions, and the light transport of every pixel.

    Args:
        subject: of ``build_subject``.
        samples: camera rays per pixel.
        seed: any non-negative integer.
        order: SH order of the transport, 0 to 8; training data has 4.
        max_bounces: surface points that light may meet after the first.
        paths: paths that go on from where each camera ray hits.
        directions: (D, 3) unit vectors toward directional lights whose responses are wanted too.

    Returns:
        ``.normal`` and ``.albedo`` (H, W, 3), ``.coverage`` and ``.mask`` (H, W), ``.regions`` (H, W) uint8,
        ``.transport`` (K, H, W, 3), ``.gloss`` (9, H, W) or (0, H, W), ``.directional`` (D, H, W, 3).
        ``Transport.of(maps, directions)`` relights them.

    Raises:
        InputError: for numbers of samples that the sampler cannot place, or directions of another length.

    Example:
        >>> import sfsnet_dr as sf
        >>> maps = sf.render_aovs(sf.build_subject("sphere"), samples=4, order=2, max_bounces=0)
        >>> maps.transport.shape
        (9, 128, 128, 3)
    """
    from sfsnet_dr.render.aovs import TransportOptions
    from sfsnet_dr.render.aovs import render_aovs as render
    from sfsnet_dr.render.renderers.mitsuba import show_subject

    options = TransportOptions(order, max_bounces, paths)
    toward = None if directions is None else np.asarray(directions, np.float64)
    return render(show_subject(subject), samples, seed, options, toward)


@overload
def shade(
    normal: NDArray[np.floating[Any]],
    light: Light | Radiance | Shading | NDArray[np.floating[Any]],
    albedo: NDArray[np.floating[Any]] | None = None,
    *,
    order: int = LIGHT_ORDER,
) -> Array: ...


@overload
def shade(
    normal: Tensor,
    light: Light | Radiance | Shading | Tensor,
    albedo: Tensor | None = None,
    *,
    order: int = LIGHT_ORDER,
) -> Tensor: ...


def shade(normal: Any, light: Any, albedo: Any = None, *, order: int = LIGHT_ORDER) -> Any:
    """Shade normals by spherical harmonics, as SfSNet's renderer does; nothing is clamped.

    The model is Lambertian: no cast shadows, no interreflection, no gloss. ``validate`` tells how wrong it is
    on a scene. Tensors are differentiable in normals, albedo and light.

    Args:
        normal: array (H, W, 3) or (B, H, W, 3), or tensor (B, 3, H, W): camera frame, any length.
        light: a light or its coefficients; or bare shading coefficients (3K,) or (B, 3K), K of red, K of
            green, K of blue, of any order up to 8 (tensors: 4).
        albedo: of the shape of ``normal``; left out, 1.
        order: SH order at which a ``Light`` is cut off, 0 to 8 (tensors: 4); others have their own.

    Returns:
        Linear image of the shape of ``normal``: float64 for arrays.

    Raises:
        InputError: naming the argument whose shape does not fit.

    Source: Sengupta et al., SfSNet, CVPR 2018, eq. 1; Ramamoorthi and Hanrahan, SIGGRAPH 2001.

    Example:
        >>> import numpy as np
        >>> import sfsnet_dr as sf
        >>> up = np.zeros((1, 1, 3))
        >>> up[..., 1] = 1
        >>> sf.shade(up, sf.Light.from_environment(1.0)).round(6).tolist()
        [[[1.0, 1.0, 1.0]]]
    """
    if isinstance(normal, np.ndarray):
        from sfsnet_dr.render.shading_numpy import f_render, shading

        single = normal.ndim == 3
        check_shape("normal", normal, "H W 3" if single else "B H W 3")
        planes = np.moveaxis(normal[None] if single else normal, -1, 1)
        flat = _flat(light, order)
        if albedo is None:
            image = shading(planes, flat)
        else:
            check_shape("albedo", albedo, "H W 3" if albedo.ndim == 3 else "B H W 3")
            image = f_render(planes, np.moveaxis(albedo[None] if albedo.ndim == 3 else albedo, -1, 1), flat)
        image = np.moveaxis(image, 1, -1)
        return image[0] if single and len(image) == 1 else image
    import torch

    from sfsnet_dr.render import shading_torch

    if not isinstance(light, torch.Tensor):
        light = torch.from_numpy(_flat(light, order)).to(normal)
    light = light[None] if light.ndim == 1 else light
    if albedo is None:
        return shading_torch.shading(normal, light)
    return shading_torch.f_render(normal, albedo, light)


def _flat(light: Any, order: int) -> Array:
    """Return shading coefficients (B, 3K)."""
    if isinstance(light, Light):
        light = light.coefficients(order)
    if isinstance(light, Radiance):
        light = light.to_shading()
    if isinstance(light, Shading):
        return light.flat()[None]
    bare = np.asarray(light, np.float64)
    return bare[None] if bare.ndim == 1 else bare


def relight(face: Decomposition | Bundle | Transport | Path | str, light: Light) -> Array:
    """Put a face under another light.

    Args:
        face: a decomposed photograph (order-2 shading: no shadows); or a rendered face with its light
            transport (shadows, interreflection and gloss): a ``Transport``, a ``Bundle``, or the EXR file of
            one that ``synthesize`` wrote.
        light: the light.

    Returns:
        Linear image (H, W, 3).

    Raises:
        InputError: for a file that is no bundle.
        TypeError: for anything else.

    Example:
        >>> import numpy as np
        >>> import sfsnet_dr as sf
        >>> face = sf.decompose(np.full((128, 128, 3), 0.3))
        >>> sf.relight(face, sf.sample_light(1)).shape
        (128, 128, 3)
    """
    from sfsnet_dr.data.bundle import Bundle, read_bundle
    from sfsnet_dr.inference.outputs import Decomposition
    from sfsnet_dr.render.transport_shading import Transport

    if isinstance(face, Decomposition | Transport):
        return face.relight(light)
    if isinstance(face, Path | str):
        face = read_bundle(face)
    if isinstance(face, Bundle):
        return Transport.of(face).relight(light)
    raise TypeError(
        f"face: {type(face).__name__} found, a Decomposition, Transport, Bundle or file is needed"
    )


def validate(
    scene: Path | str,
    out: Path | str,
    *,
    lights: str = "standard",
    tolerance: float = 0.05,
    renderers: str = "none",
    samples: int | None = None,
    size: int | None = None,
    seed: int = 0,
) -> list[Record]:
    """Measure SH shading against the path tracer on a scene: error, its causes and time, for every light.

    Args:
        scene: a TOML file, or the name of a validation scene such as ``"head"``.
        out: folder for ``records.json``, ``errors.csv``, error maps and a page, ``index.html``.
        lights: names of lights or sets of them, with commas between; ``"standard"`` has all kinds.
        tolerance: relative RMS error for which the cheapest sufficient model is named.
        renderers: other renderers to compare: ``"all"``, ``"none"``, or names with commas between.
        samples: paths per pixel of each reference; left out, the scene's.
        size: edge of the image in pixels; left out, the scene's.
        seed: of a head and of all noise.

    Returns:
        One ``Record`` for each number: ``validate.<model>.<scene>.<light>.rel_rmse`` and so on.

    Raises:
        InputError: for an unknown scene, light or renderer, or numbers out of their range.

    Example:
        >>> import tempfile
        >>> import sfsnet_dr as sf
        >>> with tempfile.TemporaryDirectory() as out:
        ...     records = sf.validate("sphere", out, lights="natural0", samples=4, size=16)
        >>> any(record.what == "validate.order2.sphere.natural0.rel_rmse" for record in records)
        True
    """
    from sfsnet_dr.experiments.validation import run

    request = run.Request(
        scene, lights, tolerance, renderers, samples, size, seed, command="sfsnet_dr.validate(...)"
    )
    return run.validate(request, out)[0]
