"""The matrix: every renderer on every scene under every light, each held to what it should show."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.experiments.regression.config import RegressSpec
from sfsnet_dr.experiments.regression.expected import Expected, ExpectedImages, allow_known_differences
from sfsnet_dr.experiments.regression.models import Model, model_of
from sfsnet_dr.experiments.regression.references import References
from sfsnet_dr.metrics.equivalence import (
    Agreement,
    Estimate,
    check_agreement,
    estimate_from_seeds,
    exact_estimate,
)
from sfsnet_dr.render.renderers.base import Budget, Capabilities
from sfsnet_dr.render.renderers.registry import find_renderer, is_built_in, renderers
from sfsnet_dr.render.renderers.sandbox import Outcome, run_sandboxed
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.lights.presets import light_set
from sfsnet_dr.scene.subject import Subject, build_subject

Array = npt.NDArray[np.float64]
Verdict = Literal["agrees", "differs", "failed", "not installed"]

#: Gives an image, or says why there is none.
Render = Callable[[Subject, Light, Budget], Outcome]

#: Rays a pixel that a model without noise of its own is taken to have made its maps with.
_RAYS: Final = 64
_SEEDS_OF_A_RUN: Final = 1000  # no run takes seeds of another


@dataclass(frozen=True, eq=False)
class Row:
    """One renderer on one scene under one light.

    Attributes:
        renderer, scene, light: their names.
        verdict: what came of it.
        detail: why it failed, or what it was compared with.
        seconds: of one image, median without the first.
        agreement: the tests; None without images.
        p: chance that anything in the whole run differs as much if nothing is wrong; 1 without images.
        image: the mean of its images.
        truth: what it was held to.
    """

    renderer: str
    scene: str
    light: str
    verdict: Verdict
    detail: str
    seconds: float = 0.0
    agreement: Agreement | None = None
    p: float = 1.0
    image: Estimate | None = None
    truth: Expected | None = None


def run_matrix(
    spec: RegressSpec,
    references: References,
    *,
    seed: int = 0,
    on_row: Callable[[Row], None] = lambda _: None,
) -> list[Row]:
    """Compare all renderers of a matrix, those of other packages in processes of their own.

    Args:
        spec: the matrix.
        references: what is stored.
        seed: of the noise; another seed gives independent images.
        on_row: called with each row as it is done, its verdict not yet final.

    Raises:
        InputError: for an unknown renderer, or a reference of ours that is missing or does not fit.
    """
    for name in spec.renderers:
        check_renderer(name)
    rows = []
    for truths in prepare_pairs(spec, references):
        for name in spec.renderers:
            row = compare_pair(name, measure_sandboxed(name), truths, spec, seed=seed)
            rows.append(row)
            on_row(row)
    return apply_tolerance(rows, spec.level)


def prepare_pairs(spec: RegressSpec, references: References) -> list[ExpectedImages]:
    """What our renderers are held to, for every scene and light: what is missing shows before any rendering.

    Raises:
        InputError: for a reference that is missing or does not fit.
    """
    found = []
    for subject, lights in load_subjects(spec):
        for light in lights:
            found.append(ExpectedImages(subject, light, references))
            for name in filter(is_built_in, spec.renderers):
                found[-1].of(find_renderer(name).capabilities)
    return found


def compare_pair(
    name: str,
    render: Render,
    truths: ExpectedImages,
    spec: RegressSpec,
    *,
    seed: int = 0,
    capabilities: Capabilities | None = None,
) -> Row:
    """One row; its ``p`` is that of the pair alone until ``apply_tolerance``.

    Args:
        name: of the renderer.
        render: makes its images.
        truths: of what it renders.
        spec: says with how many seeds and samples.
        seed: of the noise.
        capabilities: what the renderer is held to, in place of what it says of itself.

    Raises:
        InputError: for a reference that is missing or does not fit, where the renderer is ours.
    """
    subject, light = truths.subject, truths.light
    blank = Row(name, subject.spec.name, light.name, "failed", "")
    images, seconds = [], []
    for k in range(spec.seeds):
        outcome = render(subject, light, Budget(spec.samples, _SEEDS_OF_A_RUN * seed + k))
        if outcome.failure is not None or outcome.image is None:
            missing = outcome.failure is not None and outcome.failure.kind == "not installed"
            return replace(
                blank, verdict="not installed" if missing else "failed", detail=str(outcome.failure)
            )
        images.append(np.asarray(outcome.image, dtype=np.float64))
        seconds.append(outcome.seconds)
        if k == 1 and np.array_equal(images[0], images[1]):
            break  # the seed does not matter to it
    says = capabilities or outcome.capabilities
    assert says is not None
    try:
        truth = allow_known_differences(truths.of(says), spec.known_of(name, subject.spec.name))
    except InputError as error:
        if is_built_in(name):
            raise
        return replace(blank, detail=f"nothing to hold it to: {error}")
    image = exact_estimate(images[0]) if len(images) == 2 else estimate_from_seeds(images)
    tested = _with_noise_of_maps(image, truth, spec) if not image.variance.any() else image
    agreement = check_agreement(tested, truth.estimate, allowance=truth.allowance)
    return replace(
        blank,
        verdict="agrees",
        detail=truth.words,
        seconds=float(np.median(seconds[1:])),
        agreement=agreement,
        p=agreement.p,
        image=image,
        truth=truth,
    )


def apply_tolerance(rows: Iterable[Row], level: float) -> list[Row]:
    """Rows with their p corrected for the number of pairs, and their verdicts."""
    given = list(rows)
    pairs = sum(row.agreement is not None for row in given)
    return [_judged(row, pairs, level) for row in given]


def _judged(row: Row, pairs: int, level: float) -> Row:
    if row.agreement is None:
        return row
    p = row.agreement.p_among(pairs)
    return replace(row, p=p, verdict="differs" if p < level else "agrees")


def load_subjects(spec: RegressSpec) -> Iterable[tuple[Subject, list[Light]]]:
    """The surfaces of a matrix with their lights, each built when its turn comes."""
    for pair in spec.scenes:
        yield build_subject(spec.scene(pair.scene)), light_set(",".join(pair.lights))


def models_of_renderers(names: Iterable[str], subject: Subject) -> list[Model]:
    """The path-traced pictures that renderers need on a subject; those not installed say theirs too."""
    found = []
    for name in names:
        capabilities = find_renderer(name).capabilities
        if capabilities.visibility:
            found.append(model_of(capabilities, subject))
    return list(dict.fromkeys(found))


def measure_sandboxed(name: str) -> Render:
    """A renderer of a name, so that nothing it does can stop the run."""
    return lambda subject, light, budget: run_sandboxed(name, subject, light, budget)


def check_renderer(name: str) -> None:
    """Refuse an unknown name before anything is rendered.

    Raises:
        InputError: with the nearest name.
    """
    if name not in renderers():
        find_renderer(name)  # tells the nearest name


def _with_noise_of_maps(image: Estimate, truth: Expected, spec: RegressSpec) -> Estimate:
    """An image that always places its rays alike still has their noise, though nothing shows it."""
    if truth.kind != "stored maps":
        return image
    return Estimate(image.mean, truth.estimate.variance * max(spec.reference_maps / _RAYS, 1.0))
