"""The demo's page: what was done, what came out, and what it is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.core.visualize import Pixels, on_white, png_bytes, show_linear, show_normals
from sfsnet_dr.data.bundle import Bundle
from sfsnet_dr.experiments.demo.result import TOLERANCE, DemoResult
from sfsnet_dr.experiments.validation.page import scene_section
from sfsnet_dr.experiments.validation.summary import format_duration, pooled_error
from sfsnet_dr.inference.outputs import decomposition_pictures
from sfsnet_dr.models.shipped import BEST
from sfsnet_dr.report.html import Figure, Gallery, KeyNumbers, Note, Section, Table, write_page
from sfsnet_dr.report.plots import loss_curve
from sfsnet_dr.report.record import Record

_LEAD = (
    "A face is rendered with full light transport by Mitsuba 3, the cheap spherical-harmonic model of SfSNet "
    "is measured against it, the network is trained on such faces for a few minutes, and a photograph is "
    "taken apart into normals, albedo and light by the network that comes with the package. Everything here "
    "was computed by the run that wrote the page."
)


def write_demo_page(path: Path, result: DemoResult) -> None:
    """Write the page, self-contained."""
    sections = [
        _summary(result),
        _faces(result),
        *(scene_section(study, TOLERANCE) for study in result.studies),
        _training(result),
        _photograph(result),
        _unseen(result),
        _numbers(result),
        _installation(result),
    ]
    versions = result.records[-1].versions
    footer = ", ".join(f"{name} {number}" for name, number in versions.items())
    write_page(path, "sfsnet_dr: from a face to its parts", _LEAD, sections, footer=footer)


def _summary(result: DemoResult) -> Section:
    sphere, head = (pooled_error(study, "order2", study.natural) for study in result.studies)
    images = len(result.history)
    return Section(
        "In short",
        [
            KeyNumbers(
                [
                    (f"{100 * sphere.error:.1f} %", "error of order-2 SH on a sphere, natural light"),
                    (f"{100 * head.error:.1f} %", "the same on a head, where noses cast shadows"),
                    (format_duration(head.seconds), "time of one such image"),
                    (f"{result.normal_errors.mean:.1f}°", "normals of an unseen synthetic face"),
                    (f"{_value(result, 'demo.seconds') / 60:.1f} min", "time of this demo"),
                ]
            ),
            Note(
                f"Pictures are taken apart by the shipped network {BEST}; its card, "
                f"sfsnet_dr/weights/{BEST}.md, says what it was trained on and where it fails. The network "
                "trained here has seen "
                f"{images} steps on {len(result.bundles)} synthetic faces and no photograph: its normals of "
                f"the unseen face are {result.own_errors.mean:.1f} degrees off. It shows that training works."
            ),
        ],
    )


def _faces(result: DemoResult) -> Section:
    images = [(png_bytes(_lit(bundle)), f"seed {bundle.meta.seed}") for bundle in result.bundles]
    first = result.bundles[0]
    basis = first.transport[2]  # Y11e, light from the image right
    response = 0.2 + 0.2 * basis / np.abs(basis).max()
    truth = [
        (png_bytes(_lit(first)), "path traced"),
        (png_bytes(on_white(show_normals(first.normal), first.coverage)), "normals"),
        (png_bytes(on_white(show_linear(first.albedo), first.coverage)), "albedo"),
        (png_bytes(np.repeat((first.mask[..., None] * 255).astype(np.uint8), 3, axis=2)), "face mask"),
        (png_bytes(on_white(show_linear(response), first.coverage)), "response to Y11e"),
    ]
    took = f", in {result.render_seconds / result.rendered:.1f} s a face" if result.rendered else ""
    return Section(
        f"{len(result.bundles)} rendered faces",
        [
            "Adults of the Anny head model with seeded identity, expression, skin and pose, each path traced "
            f"under its own environment at {result.spec.sampling.reference_spp} paths a pixel{took}. "
            "Any other light is then a small matrix product.",
            Gallery(images),
            Gallery(
                truth, "The ground truth of the first face, and its response to one basis light (grey is 0)."
            ),
        ],
    )


def _training(result: DemoResult) -> Section:
    steps = [line for line in result.history if "total" in line]
    terms = {name: [line[name] for line in steps] for name in ("total", "recon", "normal", "albedo", "light")}
    speed = float(np.median([line["images_per_second"] for line in steps]))
    first, final = result.training.first, result.training.final
    return Section(
        "Minutes of training",
        [
            f"SfSNet as in the paper's appendix, {len(steps)} steps at {speed:.1f} images a second, each "
            "image relit by a light of its own. The reconstruction term is a Dr.Jit kernel.",
            Figure(
                loss_curve([line["step"] for line in steps], terms),
                f"Total loss {first['total']:.3f} at first, {final['total']:.3f} at last: means of 20 steps.",
            ),
        ],
    )


def _photograph(result: DemoResult) -> Section:
    face = result.photograph
    error = _value(result, "demo.astronaut.reconstruction.mae_8bit")
    return Section(
        "A photograph",
        [
            Gallery(
                [(png_bytes(picture), label) for label, picture in decomposition_pictures(face).values()],
                "Eileen Collins, NASA, public domain, brought to the canonical frame by her eye centres. "
                "White is outside the mask, an ellipse.",
            ),
            f"The reconstruction differs from the photograph by {error:.1f} of 255 on average. That says how "
            "well the parts explain the picture together, not that each is right.",
        ],
    )


def _unseen(result: DemoResult) -> Section:
    face, truth, errors = result.synthetic, result.truth, result.normal_errors
    shading = truth.reference / np.maximum(truth.albedo, 1e-3)
    known = [
        (png_bytes(show_linear(face.image)), "Input"),
        (png_bytes(on_white(show_normals(truth.normal), truth.mask)), "True normals"),
        (png_bytes(on_white(show_linear(truth.albedo), truth.mask)), "True albedo"),
        (
            png_bytes(on_white(show_linear(shading / max(1.0, _peak(shading, truth))), truth.mask)),
            "True shading",
        ),
    ]
    found = [(png_bytes(picture), label) for label, picture in decomposition_pictures(face).values()]
    return Section(
        "An unseen face beside the truth",
        [
            Gallery(known, "Ground truth of a synthetic face that was not trained on."),
            Gallery(found, "What the shipped network made of it."),
            f"Normals are off by {errors.mean:.1f} degrees on average; {errors.below20:.0f} % of the pixels "
            f"are below 20, {errors.below30:.0f} % below 30 degrees.",
        ],
    )


def _numbers(result: DemoResult) -> Section:
    rows = [[record.what, f"{record.value:.4g}", _ends(record), record.unit] for record in result.records]
    caption = "The same as in `records.json`, with 95 % intervals where they were taken."
    return Section("All numbers", [Table(["what", "value", "interval", "unit"], rows, caption)])


def _installation(result: DemoResult) -> Section:
    rows = [[check.name, "yes" if check.ok else "NO", check.detail] for check in result.doctor.checks]
    return Section("This installation", [Table(["check", "passed", "found"], rows)])


def _lit(bundle: Bundle) -> Pixels:
    return on_white(
        show_linear(bundle.reference / np.maximum(bundle.coverage, 1e-3)[..., None]), bundle.coverage
    )


def _peak(shading: NDArray[np.floating], truth: Bundle) -> float:
    return float((shading * truth.mask[..., None]).max())


def _ends(record: Record) -> str:
    return "" if record.interval is None else f"{record.interval[0]:.4g} to {record.interval[1]:.4g}"


def _value(result: DemoResult, what: str) -> float:
    return next(record.value for record in result.records if record.what == what)
