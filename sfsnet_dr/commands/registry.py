"""Which commands there are."""

from __future__ import annotations

from typing import Final

from sfsnet_dr.commands.ablations import Ablations
from sfsnet_dr.commands.bench import BenchRelight, BenchSynth
from sfsnet_dr.commands.bench_kernels import BenchLoss, BenchRender, BenchTrain
from sfsnet_dr.commands.faces import Relight, Show, Synth
from sfsnet_dr.commands.light_prior import FitLights
from sfsnet_dr.commands.lights import WorstLight
from sfsnet_dr.commands.network import Decompose, Train
from sfsnet_dr.commands.photographs import PseudoLabel
from sfsnet_dr.commands.real_faces import DataCheck, Evaluate, PhotometricStereo
from sfsnet_dr.commands.regression import Regress
from sfsnet_dr.commands.result import Command
from sfsnet_dr.commands.stability import Stability
from sfsnet_dr.commands.stages import Stages
from sfsnet_dr.commands.start import Demo, Doctor
from sfsnet_dr.commands.validation import Validate
from sfsnet_dr.commands.weights import WeightsCheck, WeightsList, WeightsMean, WeightsPack

#: Commands by the words on the command line, with the line that the overview shows.
COMMANDS: Final[dict[str, tuple[type[Command], str]]] = {
    "doctor": (Doctor, "Check that this machine can render"),
    "synth": (Synth, "Render faces with their ground truth"),
    "show": (Show, "Make a contact sheet of rendered faces"),
    "relight": (Relight, "Put one rendered face under another light"),
    "train": (Train, "Train a network by a recipe"),
    "pseudo-label": (PseudoLabel, "Label photographs with a network's answers"),
    "stages": (Stages, "Run every stage of training and measure the networks"),
    "ablations": (Ablations, "Measure what each part of the method is worth"),
    "data check": (DataCheck, "Count what a folder of a face database holds"),
    "photometric-stereo": (PhotometricStereo, "Find normals from photographs under known lights"),
    "evaluate": (Evaluate, "Measure networks and baselines on faces with known normals"),
    "fit-lights": (FitLights, "Learn from photographs which lights there are"),
    "decompose": (Decompose, "Take photographs of faces apart"),
    "weights list": (WeightsList, "Name the trained networks that come with the package"),
    "weights check": (WeightsCheck, "Measure them and compare with their cards"),
    "weights pack": (WeightsPack, "Keep a network's weights in eight bits"),
    "weights mean": (WeightsMean, "Average networks that were trained on from one another"),
    "validate": (Validate, "Measure the SH renderer against the path tracer"),
    "worst-light": (WorstLight, "Find the light under which the SH renderer is most wrong"),
    "stability": (Stability, "Put hard cases to every SH renderer and the loss"),
    "bench synth": (BenchSynth, "Measure how fast faces are rendered"),
    "bench relight": (BenchRelight, "Measure relit faces against path-traced ones"),
    "regress": (Regress, "Hold every renderer to what it should show"),
    "bench loss": (BenchLoss, "Time the reconstruction loss against torch and the memory"),
    "bench render": (BenchRender, "Time the SH renderer against torch and the memory"),
    "bench train": (BenchTrain, "Time the steps of training and what they are made of"),
    "demo": (Demo, "Run the whole pipeline and write a report"),
}
