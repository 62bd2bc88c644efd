"""Responses of a scene to basis and directional lights, path traced twice, and by the SH model.

Everything about how wrong the model is under *any* mixture of these lights follows from inner products of
the responses (``PreparedResponses``): no further image is rendered. Two captures with noise of their own,
multiplied with each other and never with themselves, leave no noise in the mean.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.render.aovs import TransportMaps, TransportOptions, render_aovs
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.lights.sampling import LARGEST_ANGLE, sample_scene_light
from sfsnet_dr.scene.lights.spec import LightSpec
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.spec import FACE_SHAPES
from sfsnet_dr.scene.subject import Subject
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.kernel import band_of, clamped_cosine
from sfsnet_dr.sh.projection import equirect_directions, equirect_solid_angles

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.floating]

#: Order of the lights that are searched, and of the analytic model at its best.
ORDER: Final = 4
COUNT: Final = (ORDER + 1) ** 2

_LAMPS = 32  # directional lights of one kernel; more take longer to compile


@dataclass(frozen=True)
class Effort:
    """What is traced.

    Attributes:
        size: width and height of the images in pixels; None is the scene's.
        samples: camera rays of a pixel for the answers to basis lights.
        paths: paths from each of them.
        lamp_samples: camera rays of a pixel for the answers to directional lights, with one path each.
        bounces: greatest number of surface points after the first one.
        level: of the icosphere of directions.
    """

    size: int | None = None
    samples: int = 64
    paths: int = 4
    lamp_samples: int = _LAMPS
    bounces: int = 5
    level: int = 3


@dataclass(frozen=True, eq=False)
class PreparedResponses:
    """Mean squares over pixels as quadratic forms in the weights w (N,) of N lights, for each colour.

    Attributes:
        truth: (3, N, N): w^T truth w is the mean square of the traced image.
        cross: (3, 25, N): inner products of the model's answers to basis lights with the traced ones.
        model: (3, 25, 25): of the model's answers with each other.
        coefficients: (25, N) radiance coefficients of the lights.
    """

    truth: Array
    cross: Array
    model: Array
    coefficients: Array

    def error(self, order: int) -> Array:
        """(3, N, N): w^T error w is the mean square of what the model of an order is off by."""
        keep = (order + 1) ** 2
        light = self.coefficients[:keep]
        mixed = np.einsum("kn,ckm->cnm", light, self.cross[:, :keep])
        both = np.einsum("kn,ckj,jm->cnm", light, self.model[:, :keep, :keep], light, optimize=True)
        return np.asarray(self.truth - mixed - mixed.transpose(0, 2, 1) + both)


@dataclass(frozen=True, eq=False)
class Responses:
    """Images under N lights, in the pixels of a mask.

    Attributes:
        first: (3, N, P) traced.
        second: (3, N, P) traced with other random numbers.
        model: (3, 25, P) of the analytic model to the basis lights.
        coefficients: (25, N) radiance coefficients of the lights.
        mask: (H, W) P times True.
    """

    first: Image
    second: Image
    model: Image
    coefficients: Array
    mask: npt.NDArray[np.bool_]

    def forms(self) -> PreparedResponses:
        """Inner products of all answers."""
        pixels = self.first.shape[-1]
        product = np.matmul(self.first, self.second.transpose(0, 2, 1)).astype(np.float64)
        mean = (self.first + self.second) / 2
        model = np.asarray(self.model, dtype=mean.dtype)
        return PreparedResponses(
            truth=(product + product.transpose(0, 2, 1)) / 2 / pixels,
            cross=np.matmul(model, mean.transpose(0, 2, 1)).astype(np.float64) / pixels,
            model=np.matmul(model, model.transpose(0, 2, 1)).astype(np.float64) / pixels,
            coefficients=self.coefficients,
        )

    def noise(self) -> Array:
        """(3, N, N): mean square of the noise of the mean of both captures, under weights w."""
        half = (self.first.astype(np.float64) - self.second) / 2
        return np.asarray(np.matmul(half, half.transpose(0, 2, 1)) / half.shape[-1])

    def images(self, weights: Array, order: int) -> tuple[Image, Image, Image]:
        """First and second traced image and the model's (H, W, 3), 0 outside the mask, of weights (N, 3)."""
        light = (self.coefficients @ weights)[: (order + 1) ** 2]
        return (
            self._image(np.einsum("cnp,nc->pc", self.first, weights)),
            self._image(np.einsum("cnp,nc->pc", self.second, weights)),
            self._image(np.einsum("ckp,kc->pc", self.model[:, : len(light)], light)),
        )

    def _image(self, values: Array) -> Image:
        image = np.zeros((*self.mask.shape, 3))
        image[self.mask] = values
        return image


@dataclass(frozen=True, eq=False)
class Target:
    """A subject as it is traced here.

    Attributes:
        subject: the surface, and a camera of the effort's size.
        scene: the same for the tracer, without light.
        effort: what is traced.
    """

    subject: Subject
    scene: SurfaceScene
    effort: Effort


def select_target(subject: Subject, effort: Effort) -> Target:
    """Make a subject ready for tracing."""
    camera = replace(subject.camera, size=effort.size or subject.camera.size)
    scene = SurfaceScene(subject.mesh, camera, gloss=subject.spec.has_gloss)
    return Target(replace(subject, camera=camera), scene, effort)


def basis_responses(of: Target, seed: int) -> Responses:
    """Answers to the 25 basis lights of order 4, everything the surface does with them included."""
    options = TransportOptions(ORDER, of.effort.bounces, of.effort.paths, gloss_order=ORDER)
    runs = [render_aovs(of.scene, of.effort.samples, 2 * seed + k, options) for k in range(2)]
    mask = masked_pixels(of.subject, runs[0])
    first, second = (_pixels(run.transport, mask) for run in runs)
    if of.scene.gloss:
        first, second = (
            answers + _pixels(np.repeat(run.gloss[..., None], 3, axis=-1), mask)
            for answers, run in zip((first, second), runs, strict=True)
        )
    return Responses(first, second, analytic_responses(runs[0], mask), np.eye(COUNT), mask)


def directional_responses(
    of: Target,
    directions: Array,
    seed: int,
    on_batch: Callable[[], None] = lambda: None,
) -> Responses:
    """Answers to directional lights of irradiance 1, with hard shadows and interreflection.

    Args:
        of: what is traced.
        directions: (N, 3) unit vectors toward the lights.
        seed: of the random numbers.
        on_batch: called ``batches(N)`` times while it goes on.
    """
    options = TransportOptions(0, of.effort.bounces, 1, gloss_order=0)
    runs, mask, model = [], None, None
    padded = np.concatenate([directions, np.repeat(directions[-1:], -len(directions) % _LAMPS, axis=0)])
    for k in range(2):
        found = []
        for start in range(0, len(padded), _LAMPS):
            run = render_aovs(
                of.scene, of.effort.lamp_samples, 2 * seed + k, options, padded[start : start + _LAMPS]
            )
            if mask is None:
                mask = masked_pixels(of.subject, run)
                model = analytic_responses(run, mask)
            found.append(_pixels(run.directional, mask).astype(np.float32))
            on_batch()
        runs.append(np.concatenate(found, axis=1)[:, : len(directions)])
    assert mask is not None
    assert model is not None
    return Responses(runs[0], runs[1], model, sh_basis(directions, ORDER).T, mask)


def light_batches(directions: int) -> int:
    """How often ``directional_responses`` reports for a number of directions."""
    return 2 * -(-directions // _LAMPS)


def masked_pixels(subject: Subject, maps: TransportMaps) -> npt.NDArray[np.bool_]:
    """(H, W) pixels that errors are measured on: face skin of a head, what else fills its pixel.

    Raises:
        InputError: if there is none.
    """
    face = subject.spec.shape in FACE_SHAPES
    mask = np.asarray(maps.mask > 0 if face else maps.coverage > 1.0 - 1e-6)
    if not mask.any():
        raise InputError(f"{subject.spec.name}: no surface in view, nothing can be measured")
    return mask


def analytic_responses(maps: TransportMaps, mask: npt.NDArray[np.bool_]) -> Array:
    """(3, 25, P) image of the SH renderer under each basis light: albedo A_l / pi Y_k(normal)."""
    normals = maps.normal[mask].astype(np.float64)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    shading = sh_basis(normals, ORDER) * (clamped_cosine(ORDER) / np.pi)[band_of(ORDER)]
    return np.asarray(np.einsum("pk,pc->ckp", shading, maps.albedo[mask].astype(np.float64)))


def _pixels(images: Image, mask: npt.NDArray[np.bool_]) -> Image:
    """(N, H, W, 3) to (3, N, P)."""
    return np.ascontiguousarray(np.moveaxis(images[:, mask], -1, 0))


#: Every kind of light that needs no files, as data sets have them, with as many of ``sh.priors``.
PRIOR: Final = LightSpec(hdr=0.0, lobes=0.25)


@dataclass(frozen=True, eq=False)
class Prior:
    """Lights drawn from the prior.

    Attributes:
        kinds: (L,) names.
        weights: (L, N, 3) irradiance from each of N directions.
    """

    kinds: tuple[str, ...]
    weights: Array


def draw_prior(directions: Array, count: int, seed: int, spec: LightSpec = PRIOR) -> Prior:
    """Draw lights.

    Lamps and suns come from the given directions exactly, at most 85 degrees from the viewer's; those of
    ``sample_scene_light`` from elsewhere are soft. Maps are gathered at the directions.

    Args:
        directions: (N, 3) unit vectors, evenly spread.
        count: how many lights.
        seed: of the lights; equal seeds give equal lights for every scene.
        spec: kinds and weights.
    """
    rng = np.random.default_rng([seed, 7])
    front = directions[directions[:, 2] >= np.cos(np.radians(LARGEST_ANGLE))]
    nearest = nearest_direction(equirect_directions(*MAP_SIZE), directions)
    lights = [sample_scene_light(rng, spec, front) for _ in range(count)]
    weights = [gather_responses(light, directions, nearest) for light in lights]
    return Prior(tuple(light.name for light in lights), np.array(weights))


def gather_responses(light: Light, directions: Array, nearest: npt.NDArray[np.intp]) -> Array:
    """(N, 3) irradiance from each direction; all light of a map's texel comes from the nearest one.

    Args:
        light: the light.
        directions: (N, 3).
        nearest: (H, W) of the map, as of ``nearest_direction``.
    """
    weights = np.zeros((len(directions), 3))
    if light.environment is not None:
        power = light.environment * equirect_solid_angles(*MAP_SIZE)[..., None]
        np.add.at(weights, nearest.ravel(), power.reshape(-1, 3))
    for toward, power in light.directional:
        weights[np.argmax(directions @ toward)] += power
    return weights


def nearest_direction(vectors: Array, directions: Array) -> npt.NDArray[np.intp]:
    """(...,) index of the direction nearest to each unit vector (..., 3)."""
    return np.asarray(np.argmax(vectors @ directions.T, axis=-1))


def prior_errors(forms: PreparedResponses, prior: Prior, order: int) -> Array:
    """(L,) relative RMS error of the model of an order under each light, over all colours."""
    error, truth = forms.error(order), forms.truth
    off = np.einsum("lnc,cnm,lmc->l", prior.weights, error, prior.weights, optimize=True)
    power = np.einsum("lnc,cnm,lmc->l", prior.weights, truth, prior.weights, optimize=True)
    return np.asarray(np.sqrt(np.maximum(off, 0.0) / power))


def mean_error(errors: Array) -> float:
    """Mean error over lights (L,)."""
    return float(errors.mean())


def percentile_95(errors: Array) -> float:
    """95th percentile of errors over lights (L,)."""
    return float(np.quantile(errors, 0.95))
