"""Commands that train networks and use them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from sfsnet_dr.commands.faces import Synth, render_faces
from sfsnet_dr.commands.result import FaceFolders, Json, Out, Result, command_line, of_records
from sfsnet_dr.model.shipped import BEST


@dataclass(frozen=True)
class Train:
    """Train a network by a recipe, on faces relit on the fly.

    Without --data the faces are rendered first, into OUT/faces. A stopped run goes on with --resume and ends
    with the same weights as one that was never stopped. Several processes or GPUs share every batch where
    torchrun starts it: torchrun --nproc-per-node 2 --no-python sfsnet-dr train RECIPE --data DIR --out OUT

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
    labels: Annotated[
        Path | None, arg(metavar="DIR", help="Photographs that `sfsnet-dr pseudo-label` labelled.")
    ] = None
    surfaces: Annotated[
        Path | None, arg(metavar="DIR", help="Faces that `sfsnet-dr photometric-stereo` labelled.")
    ] = None
    start: Annotated[
        Path | None,
        arg(metavar="FILE", help="Weights of the same network to begin with, in place of random ones."),
    ] = None
    resume: Annotated[bool, arg(help="Go on from the last checkpoint in --out.")] = False
    tensorboard: Annotated[bool, arg(help="Write for TensorBoard too, into OUT/tensorboard.")] = False
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.fit.recipe import lit_by, read_recipe
        from sfsnet_dr.fit.trainer import train
        from sfsnet_dr.report.record import dotted, measured

        recipe = lit_by(read_recipe(self.recipe), self.environments)
        data = self.data or (self.out / "faces",)
        if not self.data:
            wanted = Synth(data[0], self.faces, scene=self.scene, resume=True)
            render_faces(wanted.spec(), wanted)
        result = train(
            recipe,
            data,
            self.out,
            labels=self.labels,
            surfaces=self.surfaces,
            resume=self.resume,
            tensorboard=self.tensorboard,
            start=self.start,
        )
        records = [
            measured(f"train.loss.{dotted(term)}", value, "1", command=command_line(), seed=recipe.seed)
            for term, value in result.final.items()
        ]
        return of_records(records, f"weights: {result.weights}")


@dataclass(frozen=True)
class Decompose:
    """Take photographs of faces apart: normals, albedo, shading, reconstruction and three relit views.

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
        from sfsnet_dr.apply.decompose import decompose, reconstruction_error
        from sfsnet_dr.apply.picture import eyes_from_text
        from sfsnet_dr.report.record import dotted, measured

        eyes = None if self.eyes is None else eyes_from_text("--eyes", self.eyes)
        faces = decompose(self.images, self.out, self.weights, eyes=eyes, mask=self.mask)
        records = [
            measured(
                f"decompose.{dotted(face.name)}.reconstruction.mae_8bit",
                reconstruction_error(face),
                "8-bit sRGB",
                command=command_line(),
            )
            for face in faces
        ]
        return of_records(records, *(f"written: {self.out / face.name}" for face in faces))
