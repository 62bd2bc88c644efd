"""The page of a run: for somebody who has not read anything else."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from sfsnet_dr.core.provenance import machine, versions
from sfsnet_dr.experiments.regression.config import RegressSpec
from sfsnet_dr.experiments.regression.diagnose import Evidence
from sfsnet_dr.experiments.regression.fault_injection import FaultDetection
from sfsnet_dr.experiments.regression.matrix import Row
from sfsnet_dr.report.html import Block, Figure, Gallery, KeyNumbers, Note, Section, Table

#: Words, loud where somebody must look: nothing hangs on colours or on signs that a font may lack.
MARKS: Final = {
    "agrees": "agrees",
    "differs": "DIFFERS",
    "failed": "FAILED",
    "not installed": "not installed",
}

_SCALES = {
    "pixel": "single pixels",
    "cluster": "groups of pixels",
    "block of 8": "8 x 8 blocks",
    "block of 32": "32 x 32 blocks",
    "picture": "the whole picture",
}


def lead_text(rows: Sequence[Row], spec: RegressSpec) -> str:
    """What came out, in a sentence or two."""
    compared = [row for row in rows if row.agreement is not None]
    wrong = [row for row in rows if row.verdict in ("differs", "failed")]
    start = (
        f"{len({row.renderer for row in compared})} renderers were held to what each of them should show, "
        f"on {len({row.scene for row in compared})} scenes: {len(compared)} pairs of images. "
    )
    if wrong:
        names = ", ".join(dict.fromkeys(f"{row.renderer} on {row.scene}" for row in wrong))
        return f"{start}{len(wrong)} went wrong: {names}."
    return (
        f"{start}All agree: what differences there are, noise alone would show in most runs. "
        f"A run in which nothing is wrong fails with a chance of at most {spec.level:g}."
    )


def page_sections(rows: Sequence[Row], evidence: Sequence[Evidence], spec: RegressSpec) -> list[Section]:
    """Overview, failures in pictures, every pair, and how it works."""
    parts = [Section("Overview", [_overview(rows), *_numbers(rows)])]
    failed = [row for row in rows if row.verdict == "failed"]
    if evidence or failed:
        parts.append(
            Section("What went wrong", [*_failures(failed), *(b for e in evidence for b in _case(e))])
        )
    parts.append(Section("How it is tested", _method(spec)))
    parts += [Section(f"Every pair: {scene}", [_table(rows, scene)]) for scene in _names(rows, "scene")]
    return parts


def fault_section(found: Sequence[FaultDetection], spec: RegressSpec) -> Section:
    """Which planted defects were seen, and how small they may be."""
    rows = [
        [
            item.defect.words,
            item.host,
            "seen" if item.caught else "NOT SEEN",
            f"{len(item.seen)} of {item.tried}",
            _size(item),
            item.cause,
        ]
        for item in found
    ]
    table = Table(
        ["planted defect", "in", "seen?", "pairs that saw it", "smallest seen", "what the diagnosis said"],
        rows,
        "Each defect was planted into a path tracer (noisy) and into a shading model (without noise). It is "
        "seen if any pair of scene and light refuses the image at the level of a whole run. The smallest "
        "size was found by halving; a yes-or-no defect has none.",
    )
    caught = sum(item.caught for item in found)
    return Section(
        "Planted defects",
        [
            f"A test that cannot fail proves nothing, so {len(found)} renderers were spoiled on purpose: "
            f"{caught} of them were found out.",
            table,
        ],
    )


def clean_section(chances: Sequence[float]) -> Section:
    """How often clean runs were refused."""
    rows = [
        [f"{level:.0%}", f"{sum(p < level for p in chances) / len(chances):.1%}"]
        for level in (0.5, 0.1, 0.05, 0.01)
    ]
    return Section(
        "False alarms",
        [
            f"The path tracer was compared {len(chances)} times with nothing wrong, each time with other "
            "random numbers. A pair should be refused at most as often as its level says.",
            Table(["level of a pair", "refused"], rows),
        ],
    )


def page_footer() -> str:
    """Versions and machine."""
    found, here = versions(), machine()
    names = ", ".join(
        f"{name} {found[name]}" for name in ("sfsnet_dr", "mitsuba", "numpy", "torch") if name in found
    )
    return f"{names}; {here['cpu']}, {here['cores']} cores."


def _overview(rows: Sequence[Row]) -> Table:
    places = list(dict.fromkeys((row.scene, row.light) for row in rows))
    cells = {(row.renderer, row.scene, row.light): row for row in rows}
    lines = []
    for name in _names(rows, "renderer"):
        marks = [MARKS[cells[name, *place].verdict] if (name, *place) in cells else "" for place in places]
        lines.append([_unbroken(name), *marks])
    return Table(
        ["renderer", *(f"{scene}, {light}" for scene, light in places)],
        lines,
        "One line a renderer, one column a scene and its light.",
    )


def _numbers(rows: Sequence[Row]) -> list[Block]:
    compared = [row for row in rows if row.agreement is not None]
    if not compared:
        return [Note("No pair could be compared.")]
    smallest = min(row.p for row in compared)
    return [
        KeyNumbers(
            [
                (str(sum(row.verdict == "agrees" for row in rows)), "pairs agree"),
                (str(sum(row.verdict == "differs" for row in rows)), "pairs differ"),
                (str(sum(row.verdict == "failed" for row in rows)), "renders failed"),
                (
                    str(sum(row.verdict == "not installed" for row in rows)),
                    "renders need what is not installed",
                ),
                (f"{smallest:.2g}", "smallest p, corrected for all pairs"),
            ]
        )
    ]


def _failures(rows: Sequence[Row]) -> list[Block]:
    if not rows:
        return []
    lines = [[row.renderer, row.scene, row.light, row.detail] for row in rows]
    return [Table(["renderer", "scene", "light", "what happened"], lines, "These gave no image.")]


def _case(evidence: Evidence) -> list[Block]:
    row = evidence.row
    small, maps = evidence.pictures[:2], evidence.pictures[2:]
    return [
        f"`{row.renderer}` on {row.scene} under {row.light}, against {row.detail}. "
        f"Likeliest cause: {evidence.cause}.",
        Gallery(small),
        *(Figure(png, label) for png, label in maps),
    ]


def _table(rows: Sequence[Row], scene: str) -> Table:
    lines = []
    for row in rows:
        if row.scene != scene:
            continue
        if row.agreement is None:
            lines.append([_unbroken(row.renderer), row.light, MARKS[row.verdict], row.detail, "", "", "", ""])
            continue
        worst = row.agreement.worst
        lines.append(
            [
                _unbroken(row.renderer),
                row.light,
                MARKS[row.verdict],
                row.detail,
                f"{row.agreement.worst_z:+.1f}",
                _SCALES.get(worst.name, worst.name),
                f"{row.p:.2g}",
                f"{1e3 * row.seconds:.0f}",
            ]
        )
    return Table(
        ["renderer", "light", "verdict", "held to", "worst z", "least likely", "p", "time (ms)"],
        lines,
        "Worst z: the largest difference anywhere, in standard deviations. Least likely: the scale whose "
        "worst difference chance explains least. p: chance that any pair of a run differs as much with "
        "nothing wrong; below the level, the pair differs. Time: one image, warm.",
    )


def _method(spec: RegressSpec) -> list[Block]:
    return [
        "No renderer is compared with itself, nor with one that is right by decree. Each is held to what its "
        "own model should show: a path tracer to path tracing of the same depth, a shading model of order 2 "
        "to order-2 shading. So a pair differs only where something is wrong, not where a model is coarse "
        "(that is what `sfsnet-dr validate` measures).",
        "On the sphere and the plane a formula says what is right, without noise. On the other scenes a "
        f"stored reference does: path tracing with {spec.reference_samples} paths a pixel, or, for shading "
        f"models, NumPy in float64 on stored maps of normals and albedo.",
        f"Every renderer makes {spec.seeds} images of {spec.size} x {spec.size} pixels with different random "
        "numbers. Their spread, and the stored variance of the reference, say which differences chance "
        "explains. That is asked of single pixels, of groups of neighbours that err to the same side, of "
        "blocks, and of the whole picture, and the answer is corrected for the number of questions.",
    ]


def _size(found: FaultDetection) -> str:
    if found.smallest is None:
        return "\u2013"
    unit = found.defect.unit
    return f"{100 * found.smallest:.2g} %" if unit == "1" else f"{found.smallest:.2g} {unit}"


def _unbroken(name: str) -> str:
    return name.replace("-", "\u2011")


def _names(rows: Sequence[Row], field: str) -> list[str]:
    return list(dict.fromkeys(str(getattr(row, field)) for row in rows))
