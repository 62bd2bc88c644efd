"""The page of a set of stages: what each learnt, what it makes of unseen faces, and the paper's numbers."""

from __future__ import annotations

import time

import numpy as np
import torch
from numpy.typing import NDArray

from sfsnet_dr.core.color_torch import srgb_to_linear
from sfsnet_dr.core.visualize import Pixels, on_white, show_encoded, show_linear, show_normals
from sfsnet_dr.data.photos import PhotoSource
from sfsnet_dr.data.pseudo_labels import decode_labels, load_pseudo_labels
from sfsnet_dr.data.transforms.crop import Crop
from sfsnet_dr.experiments.pipeline.config import NETWORKS, Plan
from sfsnet_dr.experiments.pipeline.holdout_split import find_record
from sfsnet_dr.experiments.pipeline.measure import PHOTOGRAPHS, Outcome, measure_networks, training_seconds
from sfsnet_dr.inference.decompose import run_network
from sfsnet_dr.inference.outputs import decomposition_pictures
from sfsnet_dr.inference.photograph import Photograph
from sfsnet_dr.inference.sheet import SheetStyle, draw_sheet
from sfsnet_dr.render.shading_torch import shading
from sfsnet_dr.report.html import Block, Figure, KeyNumbers, Note, Section, Table, write_page
from sfsnet_dr.report.plots import loss_curve
from sfsnet_dr.report.record import Record, all_numbers, make_record, write_records

#: MAE and RMSE of reconstructions of CelebA's test faces, 8-bit units (Sengupta et al., tables 4 and 5).
PAPER = {
    "skipnet-syn": (42.83, 48.22),
    "sfsnet-syn": (48.54, 58.13),
    "sfsnet": (10.99, 13.55),
    "skipnet-plus": (11.33, 14.42),
}

_LEAD = (
    "SfS-supervision from beginning to end: SkipNet learns from rendered faces, its answers label "
    "photographs, SfSNet learns from both, and the networks that the paper compares with follow. All numbers "
    "are of faces and photographs that no network was trained on."
)
_WHAT = {
    "skipnet-syn": "SkipNet on rendered faces alone; its answers are the pseudo-labels.",
    "sfsnet": "SfSNet on mini-batches of rendered and pseudo-labelled faces: the paper's result.",
    "sfsnet-syn": "SfSNet on rendered faces alone, to compare with.",
    "skipnet-plus": "SkipNet+ on the same mixture as SfSNet, to compare with.",
}
_PARTS = ("input", "normal", "albedo", "shading", "reconstruction", "relit_left")
_STYLE = SheetStyle(cell=128, gap=14, margin=20, label=24, title=44)
#: Photographs on the page, by the share of photographs whose reconstruction by SfSNet is better.
_QUANTILES = {"one of the best 5 %": 0.05, "the median": 0.5, "one of the worst 5 %": 0.95}


def write_results(plan: Plan, source: PhotoSource, command: str, begin: float) -> list[Record]:
    """Measure all networks, and write ``records.json`` and ``index.html``."""
    outcome = measure_networks(plan, source, command)
    seconds = make_record("stages.seconds", time.perf_counter() - begin, "s", command=command)
    records = [*outcome.records, seconds]
    write_records(plan.folder / "records.json", records)
    sections = [
        _summary(outcome),
        _pseudo_labels(outcome),
        *(_stage(outcome, name) for name in NETWORKS),
        _photographs(outcome),
        _rendered(outcome),
        all_numbers(records, "images"),
    ]
    footer = ", ".join(f"{name} {number}" for name, number in seconds.versions.items())
    write_page(plan.folder / "index.html", "Stages of SfS-supervision", _LEAD, sections, footer=footer)
    return records


def _summary(outcome: Outcome) -> Section:
    kind = PHOTOGRAPHS[outcome.source.rendered]
    rows = []
    for name in NETWORKS:
        paper = PAPER[name]
        rows.append(
            [
                name,
                _cell(outcome, f"synthetic.normals.mean_deg.{name}", 1),
                _cell(outcome, f"synthetic.albedo.mae.{name}", 3),
                _cell(outcome, f"synthetic.light.relative.{name}", 2),
                _cell(outcome, f"{kind}.recon.mae.{name}", 1),
                _cell(outcome, f"{kind}.recon.rmse.{name}", 1),
                f"{paper[0]:.2f}",
                f"{paper[1]:.2f}",
            ]
        )
    headers = ["network", "normals, °", "albedo", "light", "MAE", "RMSE", "paper: MAE", "paper: RMSE"]
    shown = "photographs" if not outcome.source.rendered else "rendered faces in place of photographs"
    caption = (
        f"Means over {len(outcome.truth.image)} images of held-back rendered faces (normals: mean angle; "
        "albedo: mean absolute error; light: error over length of the coefficients) and over "
        f"{len(outcome.photographs)} held-back {shown} (reconstruction, 8-bit units)."
    )
    best = find_record(outcome.records, f"{kind}.recon.mae.sfsnet")
    angle = find_record(outcome.records, "synthetic.normals.mean_deg.sfsnet")
    assert best is not None
    assert angle is not None
    minutes = sum(
        training_seconds(outcome.histories[name], outcome.plan.recipes[name].batch_size) for name in NETWORKS
    )
    blocks: list[Block] = [
        KeyNumbers(
            [
                (f"{angle.value:.1f}°", "SfSNet's normals, unseen rendered faces"),
                (f"{best.value:.1f}", f"SfSNet's reconstruction, MAE of 255, unseen {shown}"),
                (f"{minutes / 60:.0f} min", "training of all networks"),
            ]
        ),
        Table(headers, rows, caption),
    ]
    if outcome.source.rendered:
        blocks.append(
            Note(
                "No photographs were given: rendered faces stood in for them, which shows that every stage "
                "runs and nothing about photographs. The paper's numbers are of CelebA."
            )
        )
    if outcome.plan.first.real.encoding == "srgb":
        blocks.append(Note("Trained in the paper's display-referred form, not in linear light."))
    return Section("In short", blocks)


def _pseudo_labels(outcome: Outcome) -> Section:
    labels = load_pseudo_labels(outcome.plan.labels)
    first = decode_labels(type(labels.labels)(*(part[:4] for part in labels.labels)))
    cells: list[tuple[str, Pixels]] = []
    for index in range(len(first.image)):
        mask = first.mask[index, 0].numpy()
        image, normal, albedo, confidence = (
            part[index].permute(1, 2, 0).numpy()
            for part in (first.image, first.normal, first.albedo, first.confidence)
        )
        cells += [
            (labels.names[index], show_encoded(image)),
            ("normals", on_white(show_normals(normal), mask)),
            ("albedo", on_white(show_linear(albedo), mask)),
            ("confidence", on_white(show_encoded(np.repeat(confidence, 3, 2)), mask)),
        ]
    weight = labels.labels.mask.double() / 255
    trust = float((labels.labels.confidence.double() / 255 * weight).sum() / weight.sum())
    told = outcome.labels
    rows = [[name, reason] for name, reason in list(told["skipped"].items())[:10]]
    blocks: list[Block] = [
        f"{told['labelled']} photographs were labelled by SkipNet, {len(told['skipped'])} could not be used, "
        f"{len(told['held_back'])} were held back. The mean confidence on faces is {trust:.2f}: 1 where four "
        "views of a photograph get the same answer.",
        Figure(
            draw_sheet(cells, columns=8, style=_STYLE),
            "The first photographs with their labels; white is confidence 1.",
            density=1,
        ),
    ]
    if rows:
        blocks.append(Table(["skipped", "why"], rows))
    return Section("Pseudo-labels", blocks)


def _stage(outcome: Outcome, name: str) -> Section:
    recipe, history = outcome.plan.recipes[name], outcome.histories[name]
    steps = [line for line in history if "total" in line]
    names = ["total", "recon", "normal", "albedo", "light"]
    names += ["real_recon"] if recipe.real.batch_fraction else []
    terms = {term: [line[term] for line in steps] for term in names}
    speed = float(np.median([line["images_per_second"] for line in steps]))
    minutes = training_seconds(history, recipe.batch_size) / 60
    parameters = sum(p.numel() for p in outcome.trained[name].model.parameters())
    blocks: list[Block] = [
        f"{_WHAT[name]} {parameters:,} parameters, {len(steps)} steps of {recipe.batch_size} images, "
        f"{speed:.1f} images a second, {minutes:.1f} minutes.",
        Figure(
            loss_curve([line["step"] for line in steps], terms),
            "Loss and its terms before weighting"
            + ("; real_recon is of photographs." if recipe.real.batch_fraction else "."),
        ),
    ]
    warnings = [f"Step {line['step']}: {line['warning']}." for line in history if "warning" in line]
    skipped = [
        f"Step {line['step']} was skipped: {line['skipped']}." for line in history if "skipped" in line
    ]
    blocks += [Note(text) for text in (warnings + skipped)[:5]]
    return Section(name, blocks)


def _photographs(outcome: Outcome) -> Section:
    order = np.argsort(outcome.errors["sfsnet"]["recon.mae"])
    blocks: list[Block] = []
    for label, share in _QUANTILES.items():
        index = int(order[min(round(share * (len(order) - 1)), len(order) - 1)])
        image = srgb_to_linear(outcome.photographs.images[index].float() / 255).permute(1, 2, 0).numpy()
        mask = (outcome.photographs.masks[index, 0].float() / 255).numpy()
        errors = (f"{name} {outcome.errors[name]['recon.mae'][index]:.1f}" for name in NETWORKS)
        rows = _rows(outcome, Photograph(outcome.photographs.names[index], image, mask))
        caption = f"By SfSNet's reconstruction, {label}. MAE: {', '.join(errors)}."
        blocks.append(_figure(rows, outcome.photographs.names[index], caption))
    return Section("Held-back photographs", blocks)


def _rendered(outcome: Outcome) -> Section:
    truth, blocks = outcome.truth, list[Block]()
    show = show_linear if outcome.plan.first.real.encoding == "linear" else show_encoded
    for index in range(min(2, len(truth.image))):
        maps = {
            "image": truth.image,
            "albedo": truth.albedo,
            "shading": shading(truth.normal, truth.light),
        }
        image, albedo, shade = (part[index].permute(1, 2, 0).numpy() for part in maps.values())
        mask = truth.mask[index, 0].numpy()
        peak = max(1.0, float((shade * mask[..., None]).max()))
        known: list[tuple[str, Pixels]] = [
            ("Input", show(image)),
            ("True normals", on_white(show_normals(truth.normal[index].permute(1, 2, 0).numpy()), mask)),
            ("True albedo", on_white(show(albedo), mask)),
            ("True shading", on_white(show(shade / peak), mask)),
            ("Their product", on_white(show(albedo * shade), mask)),
            ("", np.full_like(show(image), 255)),
        ]
        seen = image if outcome.plan.first.real.encoding == "linear" else _linear(image)
        rows = _rows(outcome, Photograph(f"face {index + 1}", np.asarray(seen, np.float32), mask))
        caption = "Input and product of the true parts differ by shadows, gloss and noise."
        blocks.append(_figure(known + rows, f"Rendered face {index + 1}", caption))
    return Section("Held-back rendered faces", blocks)


def _linear(shown: NDArray[np.float32]) -> NDArray[np.float32]:
    """Encoded values decoded, for ``run_network``, which encodes them again."""
    return np.asarray(srgb_to_linear(torch.from_numpy(shown)).numpy(), np.float32)


def _rows(outcome: Outcome, picture: Photograph) -> list[tuple[str, Pixels]]:
    """A row of pictures for each network."""
    cells = []
    for name, network in outcome.trained.items():
        [face] = run_network(network.model, [picture], view=Crop(len(picture.image)), values=network.encoding)
        shown = decomposition_pictures(face)
        cells += [(name if part == "input" else shown[part][0], shown[part][1]) for part in _PARTS]
    return cells


def _figure(cells: list[tuple[str, Pixels]], title: str, caption: str) -> Figure:
    return Figure(draw_sheet(cells, title=title, columns=len(_PARTS), style=_STYLE), caption, density=1)


def _cell(outcome: Outcome, what: str, digits: int) -> str:
    record = find_record(outcome.records, what)
    assert record is not None, what
    return f"{record.value:.{digits}f}"
