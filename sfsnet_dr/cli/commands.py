"""All commands by their words, in the groups that ``sfsnet-dr --help`` prints.

A new command is a dataclass with ``run`` (see ``cli.common.Command``) and one line here.
"""

from __future__ import annotations

from typing import Final

from sfsnet_dr.cli.bench import BenchLoss, BenchRelight, BenchRender, BenchSynth, BenchTrain
from sfsnet_dr.cli.common import Command
from sfsnet_dr.cli.evaluation import DataCheck, Evaluate, PhotometricStereo
from sfsnet_dr.cli.faces import ContactSheet, Relight, Synth
from sfsnet_dr.cli.start import Demo, Doctor
from sfsnet_dr.cli.training import Ablations, Decompose, PseudoLabel, Train, TrainAll
from sfsnet_dr.cli.validation import Regress, Stability, Validate, WorstLight
from sfsnet_dr.cli.weights import FitLightPrior, WeightsAverage, WeightsCheck, WeightsList, WeightsQuantize

#: Heading -> command -> (dataclass, the line of the overview).
GROUPS: Final[dict[str, dict[str, tuple[type[Command], str]]]] = {
    "Start": {
        "doctor": (Doctor, "Check that this machine can render"),
        "demo": (Demo, "Run the whole pipeline on a small scale and write a report"),
    },
    "Photographs": {
        "decompose": (Decompose, "Split photographs of faces into normals, albedo and light"),
        "weights list": (WeightsList, "List the trained networks in the package"),
    },
    "Rendered faces": {
        "synth": (Synth, "Render faces with ground truth and light transport"),
        "contact-sheet": (ContactSheet, "Write a contact sheet of rendered faces"),
        "relight": (Relight, "Relight one rendered face"),
    },
    "Training": {
        "train": (Train, "Train one network by a recipe"),
        "train-all": (TrainAll, "Run all training stages and measure the networks"),
        "ablations": (Ablations, "Train networks that differ in one setting and compare them"),
        "pseudo-label": (PseudoLabel, "Label photographs with the predictions of a network"),
        "fit-light-prior": (FitLightPrior, "Fit a prior over light to photographs"),
        "weights average": (WeightsAverage, "Average checkpoints"),
        "weights quantize": (WeightsQuantize, "Quantize weights to eight bits"),
    },
    "Evaluation": {
        "evaluate": (Evaluate, "Measure networks and baselines on faces with known normals"),
        "photometric-stereo": (PhotometricStereo, "Compute normals from photographs under several lights"),
        "data check": (DataCheck, "Count what a folder of a face database holds"),
        "weights check": (WeightsCheck, "Measure the networks in the package and compare with their cards"),
    },
    "Renderers": {
        "validate": (Validate, "Measure SH shading against the path tracer, light by light"),
        "worst-light": (WorstLight, "Search the light for which SH shading is most wrong"),
        "regress": (Regress, "Compare every renderer with analytic and stored references"),
        "stability": (Stability, "Run edge cases through every SH renderer and the loss"),
    },
    "Benchmarks": {
        "bench render": (BenchRender, "Time SH shading: Dr.Jit, torch, and the memory limit"),
        "bench loss": (BenchLoss, "Time the reconstruction loss: Dr.Jit, torch, and the memory limit"),
        "bench train": (BenchTrain, "Time a training step and its parts"),
        "bench synth": (BenchSynth, "Time the rendering of faces"),
        "bench relight": (BenchRelight, "Measure relit faces against path-traced ones"),
    },
}

COMMANDS: Final[dict[str, tuple[type[Command], str]]] = {
    name: entry for group in GROUPS.values() for name, entry in group.items()
}
