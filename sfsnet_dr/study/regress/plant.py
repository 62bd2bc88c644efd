"""Planted defects and repeated clean runs: what the matrix sees, and how often it cries wolf."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from sfsnet_dr.base.checks import WorkFailed
from sfsnet_dr.render.guard import Outcome
from sfsnet_dr.render.registry import find_renderer
from sfsnet_dr.render.renderer import Budget, Renderer
from sfsnet_dr.scene.light_sets import light_set
from sfsnet_dr.scene.lights import SceneLight
from sfsnet_dr.scene.subject import Subject, build_subject
from sfsnet_dr.study.regress.defects import DEFECTS, Defect, Planted, Remembered
from sfsnet_dr.study.regress.diagnose import diagnose
from sfsnet_dr.study.regress.matrix import Render, Row, compare
from sfsnet_dr.study.regress.references import References
from sfsnet_dr.study.regress.spec import RegressSpec, SceneLights
from sfsnet_dr.study.regress.truth import Truths

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
class Found:
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

    defect: Defect
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


def plant_all(
    spec: RegressSpec,
    references: References,
    pairs: int,
    *,
    ground: Iterable[SceneLights] = GROUND,
    search: bool = True,
    seed: int = 0,
    on_step: Callable[[], None] = lambda: None,
) -> list[Found]:
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
    remembered: dict[str, Remembered] = {}
    found = []
    for defect in DEFECTS:
        for name, suffix in (HOSTS if defect.order is None else ORDER_HOSTS).items():
            host = remembered.setdefault(name, Remembered(find_renderer(name)))

            def rows(size: float, host: Renderer = host, defect: Defect = defect) -> list[Row]:
                return _rows(Planted(host, defect, size), plot, spec, seed)

            found.append(_found(defect, name, suffix, rows, pairs, spec.level, search))
            on_step()
    return found


def steps() -> int:
    """Number of defects times hosts, for a bar."""
    return sum(len(HOSTS if defect.order is None else ORDER_HOSTS) for defect in DEFECTS)


def clean_runs(
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


def _plot(spec: RegressSpec, ground: Iterable[SceneLights], references: References) -> list[Truths]:
    found = []
    for pair in ground:
        subject = build_subject(spec.scene(pair.scene))
        found += [Truths(subject, light, references) for light in light_set(",".join(pair.lights))]
    return found


def _rows(renderer: Renderer, plot: list[Truths], spec: RegressSpec, seed: int) -> list[Row]:
    rows = [compare(renderer.name, direct(renderer), truths, spec, seed=seed) for truths in plot]
    for row in rows:
        if row.agreement is None:
            raise WorkFailed(f"{row.renderer} on {row.scene} under {row.light}: {row.detail}")
    return rows


def direct(renderer: Renderer) -> Render:
    """A renderer in this process, without a guard: what fails stops everything."""

    def render(subject: Subject, light: SceneLight, budget: Budget) -> Outcome:
        begin = time.perf_counter()
        image = renderer.render(subject, light, budget)
        return Outcome(renderer.name, image, time.perf_counter() - begin, renderer.capabilities, None)

    return render


def _found(
    defect: Defect,
    host: str,
    suffix: str,
    rows: Callable[[float], list[Row]],
    pairs: int,
    level: float,
    search: bool,
) -> Found:
    full = rows(defect.size)
    refused = sorted(
        (k for k, row in enumerate(full) if _refused(row, pairs, level)), key=lambda k: full[k].p
    )
    if not refused:
        return Found(defect, host, suffix, (), len(full), None, "not seen")
    row = full[refused[0]]
    assert row.image is not None
    assert row.truth is not None
    cause = diagnose(row.image, row.truth)
    seen = tuple(f"{full[k].scene} / {full[k].light}" for k in refused)
    smallest = None
    if search and defect.sized:
        smallest = _smallest(defect.size, lambda s: any(_refused(r, pairs, level) for r in rows(s)))
    return Found(defect, host, suffix, seen, len(full), smallest, cause.words)


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
