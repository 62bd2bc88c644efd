"""What a run of the demo found: everything that its page shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from sfsnet_dr.data.bundle import Bundle
from sfsnet_dr.experiments.doctor import Report
from sfsnet_dr.experiments.validation.summary import Study
from sfsnet_dr.inference.outputs import Decomposition
from sfsnet_dr.metrics.normals import NormalErrors
from sfsnet_dr.report.record import Record
from sfsnet_dr.scene.spec import SceneSpec
from sfsnet_dr.train.run import TrainResult

#: Relative RMS error that the demo calls good enough.
TOLERANCE: Final = 0.05


@dataclass(frozen=True)
class DemoResult:
    """Everything that the page shows.

    Attributes:
        doctor: the state of the installation.
        spec: of the rendered faces.
        bundles: the first rendered faces, for the contact sheet.
        rendered, render_seconds: faces that this run rendered, and their time.
        studies: one for each validated scene.
        training, history: what training gave, and a line for each step.
        photograph: the astronaut, decomposed by the shipped network.
        synthetic, truth: the unseen face, decomposed likewise, and its ground truth.
        normal_errors: of the unseen face on its mask; ``own_errors`` those of the network trained here.
        records: every number, in order.
    """

    doctor: Report
    spec: SceneSpec
    bundles: tuple[Bundle, ...]
    rendered: int
    render_seconds: float
    studies: tuple[Study, ...]
    training: TrainResult
    history: list[dict[str, Any]]
    photograph: Decomposition
    synthetic: Decomposition
    truth: Bundle
    normal_errors: NormalErrors
    own_errors: NormalErrors
    records: tuple[Record, ...]
