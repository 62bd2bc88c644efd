"""Fault injection: detection limits and false-alarm rate of the regression matrix."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.color import linear_to_srgb
from sfsnet_dr.core.errors import RunError
from sfsnet_dr.experiments.regression.config import RegressSpec, SceneLights
from sfsnet_dr.experiments.regression.diagnose import diagnose_difference
from sfsnet_dr.experiments.regression.expected import ExpectedImages
from sfsnet_dr.experiments.regression.matrix import Render, Row, compare_pair
from sfsnet_dr.experiments.regression.references import References
from sfsnet_dr.render.renderers.base import Budget, Capabilities, Image, Renderer
from sfsnet_dr.render.renderers.registry import find_renderer
from sfsnet_dr.render.renderers.sandbox import Outcome
from sfsnet_dr.render.renderers.sh import memoize, surface_maps
from sfsnet_dr.scene.lights.light import Light, rotation_about
from sfsnet_dr.scene.lights.presets import light_set
from sfsnet_dr.scene.subject import Subject, build_subject

Array = npt.NDArray[np.float64]

#: Turns the light about this axis, oblique to every light of the matrix.
_AXIS = np.array([0.6, 0.64, 0.48])
_EXCHANGED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_FLATTEST = 0.02  # cosine below which nothing is divided by it

#: Renders a subject under a light, and may go wrong by a size in doing so.
Wrong = Callable[[Renderer, Subject, Light, Budget, float], Image]


@dataclass(frozen=True)
class Fault:
    """A kind of defect.

    Attributes:
        kind: a word for records.
        words: what is wrong, at the size that has to be found.
        size: that size.
        unit: of the size; ``"1"`` for a share.
        render: renders with the defect.
        sized: whether smaller ones make sense.
        order: SH order of the renderers that can have it; None for any renderer.
    """

    kind: str
    words: str
    size: float
    unit: str
    render: Wrong
    sized: bool = True
    order: int | None = None


class InjectedFault:
    """A renderer with a defect.

    Args:
        host: the renderer.
        defect: the kind of defect.
        size: its size, in the defect's unit.
    """

    def __init__(self, host: Renderer, defect: Fault, size: float) -> None:
        self.name, self.capabilities = host.name, host.capabilities
        self._host, self._defect, self._size = host, defect, size

    def render(self, subject: Subject, light: Light, budget: Budget) -> Image:
        """The image with the defect."""
        return self._defect.render(self._host, subject, light, budget, self._size)


class RecordedImages:
    """A renderer that keeps its images, so that defects of the image cost no rendering.

    Args:
        host: the renderer.
    """

    def __init__(self, host: Renderer) -> None:
        self.name: str = host.name
        self.capabilities: Capabilities = host.capabilities
        self._host = host
        self._known: WeakKeyDictionary[Subject, dict[tuple[int, Budget], tuple[Light, Image]]] = (
            WeakKeyDictionary()
        )

    def render(self, subject: Subject, light: Light, budget: Budget) -> Image:
        """As the host's."""
        images = self._known.setdefault(subject, {})
        key = (id(light), budget)
        if key not in images:
            images[key] = (light, self._host.render(subject, light, budget))  # the light, to keep its id
        return images[key][1]


@memoize
def _with_albedo(subject: Subject, factor: float) -> Subject:
    return replace(subject, mesh=replace(subject.mesh, albedo=subject.mesh.albedo * factor))


@memoize
def _moved(subject: Subject, right: float) -> Subject:
    vertices = subject.mesh.vertices + np.array([right, 0.0, 0.0])
    return replace(subject, mesh=replace(subject.mesh, vertices=vertices))


@memoize
def _light_turned(light: Light, degrees: float) -> Light:
    return light.turned(rotation_about(_AXIS, degrees))


@memoize
def _light_exchanged(light: Light) -> Light:
    return light.turned(_EXCHANGED)


def _brighter(host: Renderer, subject: Subject, light: Light, budget: Budget, size: float) -> Image:
    return host.render(_with_albedo(subject, 1 + size), light, budget)


def _turned(host: Renderer, subject: Subject, light: Light, budget: Budget, size: float) -> Image:
    return host.render(subject, _light_turned(light, size), budget)


def _exchanged(host: Renderer, subject: Subject, light: Light, budget: Budget, size: float) -> Image:
    return host.render(subject, _light_exchanged(light), budget)


def _shifted(host: Renderer, subject: Subject, light: Light, budget: Budget, size: float) -> Image:
    pixel = 2.0 / subject.camera.size  # scene units at z = 0
    return host.render(_moved(subject, size * pixel), light, budget)


def _without_cosine(host: Renderer, subject: Subject, light: Light, budget: Budget, size: float) -> Image:
    """Divided by the cosine to the first lamp, or, without a lamp, to the brightest side of the map."""
    image = np.asarray(host.render(subject, light, budget), dtype=np.float64)
    normal = np.moveaxis(surface_maps(subject).normal[0].astype(np.float64), 0, -1)
    if light.directional:
        toward = light.directional[0][0]
    else:
        mean = light.coefficients(1).values[1:].sum(axis=1)[[1, 2, 0]]  # z, x, y to x, y, z
        toward = mean / max(float(np.linalg.norm(mean)), 1e-12)
    cosine = np.where(normal @ toward > _FLATTEST, normal @ toward, 1.0)
    return np.asarray(image * cosine[..., None] ** -size)


def _curved(host: Renderer, subject: Subject, light: Light, budget: Budget, size: float) -> Image:
    """An image that is already linear light for its reader goes through the sRGB curve once more."""
    image = np.asarray(host.render(subject, light, budget), dtype=np.float64)
    return np.asarray((1 - size) * image + size * linear_to_srgb(np.maximum(image, 0.0)))


def _lower_order(host: Renderer, subject: Subject, light: Light, budget: Budget, size: float) -> Image:
    from sfsnet_dr.render.renderers.registry import find_renderer

    image = np.asarray(host.render(subject, light, budget), dtype=np.float64)
    lower = find_renderer(host.name.replace("order4", "order2")).render(subject, light, budget)
    return np.asarray((1 - size) * image + size * lower)


DEFECTS: Final = (
    Fault("albedo", "albedo 1 % too bright", 0.01, "1", _brighter),
    Fault("light_direction", "the light turned by 1 degree", 1.0, "degree", _turned),
    Fault("swapped_axis", "the light's x and y axes exchanged", 1.0, "1", _exchanged, sized=False),
    Fault("half_pixel", "the picture moved by half a pixel", 0.5, "pixel", _shifted),
    Fault("missing_cosine", "no cosine between surface and light", 1.0, "1", _without_cosine),
    Fault("srgb_twice", "the sRGB curve applied once too often", 1.0, "1", _curved),
    Fault("order", "light of order 2 passed for order 4", 1.0, "1", _lower_order, order=4),
)


#: Where defects are planted: a formula and a stored reference; a map and lamps.
GROUND: Final = (
    SceneLights("sphere", ("two_colours",)),
    SceneLights("glossy_head", ("natural0", "directional60")),
)
#: What they are planted into, with a word for records: the noisiest of ours, and one without noise.
HOSTS: Final = {"mitsuba-llvm-path": "", "drjit-order4": ".noise_free"}
#: The same for what only renderers of order 4 can have.
ORDER_HOSTS: Final = {"drjit-order4-visibility": "", "drjit-order4": ".noise_free"}

_SMALLEST = 1024.0  # times smaller than the size that has to be found: where the search for less ends
_HALVINGS = 6  # of the search, in the logarithm: to 11 %


@dataclass(frozen=True)
class FaultDetection:
    """What became of one defect in one renderer.

    Attributes:
        defect: what was planted.
        host: the renderer's name.
        suffix: what distinguishes it in records.
        seen: pairs of scene and light that refused it, the clearest first.
        tried: number of pairs.
        smallest: smallest size that was still seen; None if not sought, or not even the full one was.
        cause: what the diagnosis said of the clearest pair.
    """

    defect: Fault
    host: str
    suffix: str
    seen: tuple[str, ...]
    tried: int
    smallest: float | None
    cause: str

    @property
    def caught(self) -> bool:
        """Whether any pair refused it."""
        return bool(self.seen)


def inject_faults(
    spec: RegressSpec,
    references: References,
    pairs: int,
    *,
    ground: Iterable[SceneLights] = GROUND,
    search: bool = True,
    seed: int = 0,
    on_step: Callable[[], None] = lambda: None,
) -> list[FaultDetection]:
    """Plant every defect into its hosts, and search for the smallest size of each that is seen.

    Args:
        spec: says with how many seeds and samples, and the level.
        references: what is stored.
        pairs: number of pairs in a whole run, which the level is corrected for.
        ground: where they are planted.
        search: whether to look for smaller sizes.
        seed: of the noise.
        on_step: called after each defect.
    """
    plot = _plot(spec, ground, references)
    remembered: dict[str, RecordedImages] = {}
    found = []
    for defect in DEFECTS:
        for name, suffix in (HOSTS if defect.order is None else ORDER_HOSTS).items():
            host = remembered.setdefault(name, RecordedImages(find_renderer(name)))

            def rows(size: float, host: Renderer = host, defect: Fault = defect) -> list[Row]:
                return _rows(InjectedFault(host, defect, size), plot, spec, seed)

            found.append(_found(defect, name, suffix, rows, pairs, spec.level, search))
            on_step()
    return found


def fault_sizes() -> int:
    """Number of defects times hosts, for a bar."""
    return sum(len(HOSTS if defect.order is None else ORDER_HOSTS) for defect in DEFECTS)


def repeat_clean_runs(
    spec: RegressSpec,
    references: References,
    repeats: int,
    *,
    ground: Iterable[SceneLights] = GROUND,
    on_step: Callable[[], None] = lambda: None,
) -> list[float]:
    """Compare the noisiest renderer without any defect again and again, each time with other seeds.

    Returns:
        p of every pair, not corrected for their number: at most a share x of them may lie below x.
    """
    plot = _plot(spec, ground, references)
    host = find_renderer(next(iter(HOSTS)))
    chances = []
    for repeat in range(repeats):
        chances += [row.p for row in _rows(host, plot, spec, 1 + repeat)]
        on_step()
    return chances


def _plot(spec: RegressSpec, ground: Iterable[SceneLights], references: References) -> list[ExpectedImages]:
    found = []
    for pair in ground:
        subject = build_subject(spec.scene(pair.scene))
        found += [ExpectedImages(subject, light, references) for light in light_set(",".join(pair.lights))]
    return found


def _rows(renderer: Renderer, plot: list[ExpectedImages], spec: RegressSpec, seed: int) -> list[Row]:
    rows = [compare_pair(renderer.name, direct_image(renderer), truths, spec, seed=seed) for truths in plot]
    for row in rows:
        if row.agreement is None:
            raise RunError(f"{row.renderer} on {row.scene} under {row.light}: {row.detail}")
    return rows


def direct_image(renderer: Renderer) -> Render:
    """A renderer in this process, without a guard: what fails stops everything."""

    def render(subject: Subject, light: Light, budget: Budget) -> Outcome:
        begin = time.perf_counter()
        image = renderer.render(subject, light, budget)
        return Outcome(renderer.name, image, time.perf_counter() - begin, renderer.capabilities, None)

    return render


def _found(
    defect: Fault,
    host: str,
    suffix: str,
    rows: Callable[[float], list[Row]],
    pairs: int,
    level: float,
    search: bool,
) -> FaultDetection:
    full = rows(defect.size)
    refused = sorted(
        (k for k, row in enumerate(full) if _refused(row, pairs, level)), key=lambda k: full[k].p
    )
    if not refused:
        return FaultDetection(defect, host, suffix, (), len(full), None, "not seen")
    row = full[refused[0]]
    assert row.image is not None
    assert row.truth is not None
    cause = diagnose_difference(row.image, row.truth)
    seen = tuple(f"{full[k].scene} / {full[k].light}" for k in refused)
    smallest = None
    if search and defect.sized:
        smallest = _smallest(defect.size, lambda s: any(_refused(r, pairs, level) for r in rows(s)))
    return FaultDetection(defect, host, suffix, seen, len(full), smallest, cause.words)


def _refused(row: Row, pairs: int, level: float) -> bool:
    assert row.agreement is not None
    return row.agreement.p_among(pairs) < level


def _smallest(size: float, seen: Callable[[float], bool]) -> float:
    """The smallest size that is seen, by halving the logarithm between it and one that is not."""
    low, high = size / _SMALLEST, size
    for _ in range(_HALVINGS):
        middle = (low * high) ** 0.5
        low, high = (low, middle) if seen(middle) else (middle, high)
    return high
