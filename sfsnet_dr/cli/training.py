"""Commands that train networks, label photographs, decompose them, and run ablations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from sfsnet_dr.cli.common import FaceFolders, Json, Out, Result, command_line, result_of_records
from sfsnet_dr.cli.faces import Synth, render_faces
from sfsnet_dr.models.shipped import BEST


@dataclass(frozen=True)
class Train:
    """Train one network by a recipe, on rendered faces that are relit on the fly.

    Without --data the faces are rendered first, into OUT/faces. --resume continues a stopped run; it ends
    with the same weights as a run that was never stopped. Several processes or GPUs share every batch:
    torchrun --nproc-per-node 2 --no-python sfsnet-dr train RECIPE --data DIR --out OUT

    Example: sfsnet-dr train training/recipes/smoke.toml --out out/smoke
    """

    recipe: Positional[
        Annotated[Path, arg(metavar="RECIPE", help="Recipe (TOML); its head says what it costs.")]
    ]
    out: Out
    data: FaceFolders = ()
    faces: Annotated[int, arg(help="Faces to render where --data is not given.")] = 24
    scene: Annotated[
        Path | None, arg(metavar="FILE", help="Their scene (TOML); left out, that of scenes/faces.toml.")
    ] = None
    environments: Annotated[
        Path | None,
        arg(metavar="DIR", help="Environment maps (.exr, .hdr) to light by, in place of the recipe's."),
    ] = None
    pseudo_labels: Annotated[
        Path | None, arg(metavar="DIR", help="Photographs labelled by `sfsnet-dr pseudo-label`.")
    ] = None
    normal_labels: Annotated[
        Path | None, arg(metavar="DIR", help="Normals computed by `sfsnet-dr photometric-stereo`.")
    ] = None
    init_weights: Annotated[
        Path | None, arg(metavar="FILE", help="Weights of the same network to start from. Default: random.")
    ] = None
    resume: Annotated[bool, arg(help="Go on from the last checkpoint in --out.")] = False
    tensorboard: Annotated[bool, arg(help="Write for TensorBoard too, into OUT/tensorboard.")] = False
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.report.record import dotted_word, make_record
        from sfsnet_dr.scene.spec import refuse_light
        from sfsnet_dr.train.config import read_recipe, with_environments
        from sfsnet_dr.train.trainer import train

        recipe = with_environments(read_recipe(self.recipe), self.environments)
        data = self.data or (self.out / "faces",)
        if not self.data:
            wanted = Synth(data[0], self.faces, scene=self.scene, resume=True)
            scene = refuse_light(
                wanted.spec(),
                self.scene or "scene",
                "training images are lit as the recipe's [data.light] says",
            )
            render_faces(scene, wanted)
        result = train(
            recipe,
            data,
            self.out,
            labels=self.pseudo_labels,
            surfaces=self.normal_labels,
            resume=self.resume,
            tensorboard=self.tensorboard,
            start=self.init_weights,
        )
        records = [
            make_record(
                f"train.loss.{dotted_word(term)}", value, "1", command=command_line(), seed=recipe.seed
            )
            for term, value in result.final.items()
        ]
        return result_of_records(records, f"weights: {result.weights}")


@dataclass(frozen=True)
class Decompose:
    """Split photographs of faces into normals, albedo, shading and light, and relight them.

    Writes OUT/NAME for each NAME.png: eight pictures, a sheet of them, and decomposition.exr to compute with.
    A picture must be 128 x 128 in the canonical frame (eye centres at (45, 48) and (83, 48), x right, y
    down), or its eye centres must be given: by --eyes, or in NAME.toml beside it with the two lines
    eye_image_left = [x, y] and eye_image_right = [x, y].

    Example: sfsnet-dr decompose me.jpg --eyes 201,190,255,188 --out out/me
    """

    images: Positional[
        Annotated[
            tuple[Path, ...],
            arg(
                metavar="IMAGE",
                help_behavior_hint="(required, several allowed)",
                help="PNG, JPEG, EXR or HDR.",
            ),
        ]
    ]
    out: Out
    weights: Annotated[
        Path,
        arg(metavar="FILE", help="Weights that `sfsnet-dr train` wrote, or the name of a shipped network."),
    ] = Path(BEST)
    eyes: Annotated[
        str | None,
        arg(
            metavar="XL,YL,XR,YR",
            help="Eye centres in pixels, the one on the image's left first; holds for every image.",
        ),
    ] = None
    mask: Annotated[Path | None, arg(metavar="FILE", help="Picture of its size, white on the face.")] = None
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.inference.decompose import decompose_files, reconstruction_error
        from sfsnet_dr.inference.photograph import parse_eyes
        from sfsnet_dr.report.record import dotted_word, make_record

        eyes = None if self.eyes is None else parse_eyes("--eyes", self.eyes)
        faces = decompose_files(self.images, self.out, self.weights, eyes=eyes, mask=self.mask)
        records = [
            make_record(
                f"decompose.{dotted_word(face.name)}.reconstruction.mae_8bit",
                reconstruction_error(face),
                "8-bit sRGB",
                command=command_line(),
            )
            for face in faces
        ]
        return result_of_records(records, *(f"written: {self.out / face.name}" for face in faces))


@dataclass(frozen=True)
class PseudoLabel:
    """Label photographs of faces with the predictions of a network and their confidence.

    PHOTOS is a folder of JPEG or PNG files whose 68 landmarks a face are in landmarks.npz, or in
    PHOTOS_landmarks.npz beside it (files: N names, points: N x 68 x 2 pixels), or a folder of such folders.
    OUT/manifest.json lists the skipped photographs with reasons, and those left for validation. The same
    command continues a stopped run.

    Example: sfsnet-dr pseudo-label photos --weights out/skipnet/weights.safetensors --out out/labels
    """

    photographs: Positional[Annotated[Path, arg(metavar="PHOTOS", help="Folder of photographs.")]]
    weights: Annotated[
        Path, arg(metavar="FILE", help="Weights file, or the name of a network in the package.")
    ]
    out: Out
    size: Annotated[
        int | None, arg(help="Width of the labels in pixels; left out, that of the weights' training.")
    ] = None
    num_val: Annotated[int, arg(help="Photographs left without labels, for validation.")] = 500
    max_images: Annotated[int | None, arg(help="Label at most this many photographs.")] = None
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.data.photos import photo_folder
        from sfsnet_dr.report.console import progress_bar
        from sfsnet_dr.report.record import make_record
        from sfsnet_dr.train.pseudo_label import pseudo_label

        source = photo_folder(self.photographs, held_back=self.num_val, most=self.max_images)
        with progress_bar("labelling photographs", len(source.train)) as advance:

            def on_shard(count: int) -> None:
                for _ in range(count):
                    advance()

            told = pseudo_label(source, self.weights, self.out, size=self.size, on_shard=on_shard)
        numbers = {
            "labelled": told["labelled"],
            "skipped": len(told["skipped"]),
            "held_back": len(told["held_back"]),
        }
        records = [
            make_record(f"pseudo_label.{name}", count, "photographs", command=command_line())
            for name, count in numbers.items()
        ]
        skipped = [f"skipped: {name}: {reason}" for name, reason in list(told["skipped"].items())[:20]]
        return result_of_records(records, *skipped, f"written: {self.out}")


@dataclass(frozen=True)
class TrainAll:
    """Run all stages of a training file: a release, or the networks of the paper side by side.

    A release (training/release/*.toml, with [[stage]] tables) makes one network, from rendered faces to
    OUT/NAME.safetensors and its card. A set (training/small.toml, training/full.toml) trains SkipNet, labels
    the photographs with it, trains SfSNet and SkipNet+ on both, and measures all of them: OUT/index.html.
    The plan is printed first: what is done, what is missing, what it costs. The same command continues a
    stopped run, and ends with the same weights.

    Example: sfsnet-dr train-all training/small.toml --photographs photos --out out/train
    """

    stages: Positional[
        Annotated[Path, arg(metavar="FILE", help="Release or set of stages (TOML); its head says the cost.")]
    ]
    out: Out
    photographs: Annotated[Path | None, arg(metavar="DIR", help="Folder of photographs with landmarks.")] = (
        None
    )
    environments: Annotated[
        Path | None,
        arg(metavar="DIR", help="Environment maps (.exr, .hdr) to light by, in place of the recipes'."),
    ] = None
    database: Annotated[
        Path | None, arg(metavar="DIR", help="Release: Extended Yale B, for labels without known lights.")
    ] = None
    model_path: Annotated[
        Path | None, arg(metavar="PATH", help="Release: ICT FaceKit, for the faces that need it.")
    ] = None
    dry_run: Annotated[bool, arg(help="Release: print the plan and stop.")] = False
    data: FaceFolders = ()
    rendered_photographs: Annotated[
        bool, arg(help="Set: let rendered faces stand in for photographs, to see the stages run.")
    ] = False
    normal_labels: Annotated[
        Path | None,
        arg(metavar="DIR", help="Set: labels by `sfsnet-dr photometric-stereo`, to fine-tune SfSNet last."),
    ] = None
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.core.config import read_toml
        from sfsnet_dr.core.errors import InputError

        release = "stage" in read_toml(self.stages)
        other = {
            "--data": self.data,
            "--rendered-photographs": self.rendered_photographs,
            "--normal-labels": self.normal_labels,
        }
        if not release:
            other = {"--database": self.database, "--model-path": self.model_path, "--dry-run": self.dry_run}
        for option, value in other.items():
            if value:
                kind = "release" if release else "set of stages"
                raise InputError(f"{option}: has no effect on {self.stages}, a {kind}; leave it out")
        return self._run_release() if release else self._run_set()

    def _run_release(self) -> Result:
        from sfsnet_dr.experiments.pipeline.release import Inputs, plan_release, plan_text, run_release
        from sfsnet_dr.experiments.pipeline.release_config import read_release

        release = read_release(self.stages, environments=self.environments)
        inputs = Inputs(self.database, self.photographs, self.model_path)
        if self.dry_run:
            return Result(text=plan_text(plan_release(release, self.out, inputs)), json="[]")
        records = run_release(release, self.out, inputs, command=command_line())
        return result_of_records(records, f"weights: {self.out / release.spec.name}.safetensors")

    def _run_set(self) -> Result:
        from sfsnet_dr.experiments.pipeline.config import read_plan
        from sfsnet_dr.experiments.pipeline.run import run_stages

        plan = read_plan(
            self.stages,
            self.out,
            data=self.data,
            photographs=self.photographs,
            rendered_photographs=self.rendered_photographs,
            environments=self.environments,
            surfaces=self.normal_labels,
        )
        return result_of_records(run_stages(plan, command=command_line()), f"page: {self.out / 'index.html'}")


@dataclass(frozen=True)
class Ablations:
    """Train networks that differ in one setting each and compare them: OUT/index.html.

    Renders a few faces per scene, trains a small network per variant of FILE, and measures all networks on
    the same validation faces. The same command continues a stopped run. Variants that lack their data are
    left out and listed.

    Example: sfsnet-dr ablations training/ablations.toml --out out/ablations
    """

    ablations: Positional[
        Annotated[Path, arg(metavar="FILE", help="Set of ablations (TOML); its head says what it costs.")]
    ]
    out: Out
    normal_labels: Annotated[
        Path | None,
        arg(metavar="DIR", help="Labels by `sfsnet-dr photometric-stereo`, to measure on too."),
    ] = None
    photographs: Annotated[
        Path | None,
        arg(metavar="DIR", help="Photographs with landmarks, for the variants that learn from some."),
    ] = None
    environments: Annotated[
        Path | None,
        arg(metavar="DIR", help="Environment maps (.exr, .hdr) to light by, in place of the recipe's."),
    ] = None
    model_path: Annotated[
        Path | None, arg(metavar="PATH", help="Face model of the variants that need a file: ict's .npz.")
    ] = None
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.experiments.ablation.config import read_ablations
        from sfsnet_dr.experiments.ablation.run import run_ablations

        plan = read_ablations(
            self.ablations,
            self.out,
            photographs=self.photographs,
            surfaces=self.normal_labels,
            environments=self.environments,
            model_path=self.model_path,
        )
        records = run_ablations(plan, command=command_line())
        lines = [f"left out: {name} {why}" for name, why in plan.left_out.items()]
        return result_of_records(records, *lines, f"page: {self.out / 'index.html'}")
