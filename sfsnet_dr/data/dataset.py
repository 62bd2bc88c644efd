"""A folder of bundles as an endless, repeatable sequence of freshly relit training batches."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.conventions import FACE_SIZE, LIGHT_ORDER
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.batch import FaceBatch, epoch_indices, shard
from sfsnet_dr.data.bundle import Bundle, read_bundle
from sfsnet_dr.data.manifest import NAME, Entry, Manifest
from sfsnet_dr.data.transforms.background import Augmentation, render_backgrounds
from sfsnet_dr.data.transforms.camera import PhotoEffects, frame_masks, sample_effects, simulate_photograph
from sfsnet_dr.data.transforms.crop import Crop
from sfsnet_dr.data.transforms.mirror import mirror_map, mirror_normal, x_parity
from sfsnet_dr.render.transport_shading import relight_batch
from sfsnet_dr.scene.lights.batch import Lighting, light_faces
from sfsnet_dr.scene.lights.cache import LightCache, draw_lights
from sfsnet_dr.scene.lights.light import MAP_ORDER
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.kernel import order_of

Array = NDArray[np.float64]

_MIRROR: Final = np.array([-1.0, 1.0, 1.0])
#: Toward what is behind the face.
_BEHIND: Final = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class Faces:
    """N faces of one size in memory, half precision: 3.8 MB a face of 128 x 128 with all its responses.

    Args:
        normal: (N, 3, H, W), ``albedo`` likewise; ``mask`` and ``coverage``: (N, 1, H, W).
        transport: of order 2 to 4, (N, K, 3, H, W).
        gloss: (N, 9, H, W); (N, 0, H, W) for diffuse surfaces.
        lamps: directional responses, (N, D, 3, H, W).
        directions: toward these lights, (N, D, 3) float64, on the CPU.
        names: N file names.
        fingerprint: of the bundles' hashes and the view; the same for the same data.
    """

    normal: Tensor
    albedo: Tensor
    mask: Tensor
    coverage: Tensor
    transport: Tensor
    gloss: Tensor
    directional: Tensor
    directions: Array
    names: tuple[str, ...]
    fingerprint: str

    def __len__(self) -> int:
        return len(self.names)

    def to(self, device: torch.device | str) -> Faces:
        """The same faces in another device's memory."""
        values: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        moved = {name: value.to(device) for name, value in values.items() if isinstance(value, Tensor)}
        return replace(self, **cast(dict[str, Any], moved))


Folders = Path | str | Sequence[Path | str]


def load_faces(
    folders: Folders, view: Crop | None = None, *, held_back: int = 0, held: bool = False
) -> Faces:
    """Read every bundle that the folders' manifests list, folder by folder in the order of their seeds.

    Args:
        folders: what ``sfsnet-dr synth`` wrote, one folder or several.
        view: how much of the frame is shown, and with how many pixels; None keeps the bundles as they are.
        held_back: bundles that are kept for measuring: those with the lowest hashes of their bytes, so that
            it hardly depends on the others whether one is.
        held: read these instead of the rest.

    Returns:
        All faces in memory, in half precision; ``RelitFaces`` makes training batches of them.

    Raises:
        InputError: if there is no manifest, it is empty, half or more would be held back, or a bundle is
            missing, damaged, of another size or other responses than the first, of too low an order, has an
            empty mask, or has fewer pixels than the view.

    Example:
        >>> import sfsnet_dr as sf
        >>> sf.load_faces("no-such-folder")
        Traceback (most recent call last):
        ...
        sfsnet_dr.core.errors.InputError: no-such-folder: ...
    """
    bundles = list_bundles(folders)
    ranks = sorted(entry.sha256 for _, entry in bundles)
    if not 0 <= held_back < max(1, len(ranks) / 2):
        raise InputError(
            f"data.num_val: {held_back} of {len(ranks)} bundles found, less than half is allowed"
        )
    kept = set(ranks[:held_back])
    chosen = [(path, entry) for path, entry in bundles if (entry.sha256 in kept) == held]
    planes: dict[str, Tensor] = {}
    directions = []
    for number, (path, _) in enumerate(chosen):
        bundle = read_bundle(path)
        directions.append(bundle.directions)
        for name, tensor in _tensors(path, bundle, view).items():
            whole = planes.setdefault(name, tensor.new_empty(len(chosen), *tensor.shape))
            if tensor.shape != whole.shape[1:]:
                raise InputError(
                    f"{path}: {_difference(tensor, whole[0])} expected as in {chosen[0][0].name}"
                )
            whole[number] = tensor
    digest = hashlib.sha256(_label(view).join(entry.sha256 for _, entry in chosen).encode()).hexdigest()
    several = len({path.parent for path, _ in chosen}) > 1
    names = (f"{path.parent.name}/{path.name}" if several else path.name for path, _ in chosen)
    return Faces(**planes, directions=np.stack(directions), names=tuple(names), fingerprint=digest)


def list_bundles(folders: Folders) -> list[tuple[Path, Entry]]:
    """The bundles of all folders with their files, folder by folder in the order of their seeds.

    Raises:
        InputError: if there is no manifest, or it is empty.
    """
    found = []
    for folder in [folders] if isinstance(folders, Path | str) else folders:
        entries = sorted(Manifest(folder).entries, key=lambda entry: (entry.seed, entry.file))
        if not entries:
            raise InputError(f"{folder}: no bundles listed in {NAME}; render some with `sfsnet-dr synth`")
        found += [(Path(folder) / entry.file, entry) for entry in entries]
    return found


def _label(view: Crop | None) -> str:
    """A view in a fingerprint: the size alone where the whole frame is shown."""
    return "None" if view is None else f"{view.size}" + (f" of {view.crop}" if view.crop < FACE_SIZE else "")


def _difference(found: Tensor, expected: Tensor) -> str:
    if found.shape[-2:] != expected.shape[-2:]:
        return f"{tuple(found.shape[-2:])} pixels found, {tuple(expected.shape[-2:])}"
    return f"{len(found)} responses found, {len(expected)}"


def _tensors(path: Path, bundle: Bundle, view: Crop | None) -> dict[str, Tensor]:
    if order_of(len(bundle.transport)) < LIGHT_ORDER:
        raise InputError(f"{path}: {len(bundle.transport)} transport coefficients found, 9 are needed")
    if not bundle.mask.any():
        raise InputError(f"{path}: the mask is empty; a face must be in the picture")
    arrays = {
        "normal": np.moveaxis(bundle.normal, -1, 0),
        "albedo": np.moveaxis(bundle.albedo, -1, 0),
        "mask": bundle.mask[None],
        "coverage": bundle.coverage[None],
        "transport": np.moveaxis(bundle.transport[: (MAP_ORDER + 1) ** 2], -1, 1),
        "gloss": bundle.gloss,
        "directional": np.moveaxis(bundle.directional, -1, 1),
    }
    tensors = {name: torch.from_numpy(np.ascontiguousarray(a)) for name, a in arrays.items()}
    if view is not None:
        try:
            tensors = {name: view.apply(tensor) for name, tensor in tensors.items()}
        except InputError as error:
            raise InputError(f"{path}: {error}; see data.size and data.crop") from error
    return {name: tensor.half() for name, tensor in tensors.items()}


class RelitFaces:
    """Batches of faces under lights nobody rendered, photographed.

    Batch k depends on the seed and on k alone: whoever computes it, in whatever order, gets the same, so
    that a resumed run needs no generator's state. Every face is seen once before one is seen again.

    Args:
        faces: what ``load_faces`` gives, on any device; batches are made there.
        batch_size: images a batch.
        augmentation: how they vary.
        seed: chooses the sequence.
        bank: the lights; drawn as the augmentation says if left out.
    """

    def __init__(
        self,
        faces: Faces,
        batch_size: int,
        augmentation: Augmentation,
        seed: int,
        bank: LightCache | None = None,
    ) -> None:
        self.faces = faces
        self.batch_size = batch_size
        self.augmentation = augmentation
        self.seed = seed
        self.bank = bank or draw_lights(augmentation.light, augmentation.num_lights, seed)

    @property
    def fingerprint(self) -> str:
        """Of the faces and the lights; batches of equal settings and seed are equal if this is."""
        return hashlib.sha256((self.faces.fingerprint + self.bank.fingerprint).encode()).hexdigest()

    def indices(self, step: int) -> list[int]:
        """Faces of a batch."""
        return epoch_indices(self.seed, 0, len(self.faces), step, self.batch_size)

    def names(self, step: int) -> list[str]:
        """Faces of a batch."""
        return [self.faces.names[index] for index in self.indices(step)]

    def batch(self, step: int, rank: int = 0, size: int = 1) -> FaceBatch:
        """Batch number ``step``, or part ``rank`` of ``size``, relit and photographed on the device."""
        part = shard(self.batch_size, rank, size)
        rng = np.random.default_rng([self.seed, 1, step])
        faces, chosen = self.faces, self.indices(step)
        flips = rng.uniform(size=len(chosen)) < self.augmentation.flip
        directions = np.where(flips[:, None, None], _MIRROR, 1.0) * faces.directions[chosen]
        lighting = light_faces(rng, self.bank, directions, self.augmentation.light)
        effects = [sample_effects(rng, self.augmentation.photo) for _ in chosen]
        place = np.maximum(np.einsum("k,bkc->bc", sh_basis(_BEHIND, MAP_ORDER), lighting.radiance), 0.0)
        pixels = (faces.normal.shape[-2], faces.normal.shape[-1])
        behind = render_backgrounds(rng, lighting.level, place, pixels, faces.normal.device)[part]
        # All is drawn for the whole batch, so that an image does not depend on who makes it.
        flips, lighting, effects = flips[part], lighting.part(part), effects[part]
        rows = torch.tensor(chosen[part], device=faces.normal.device)
        normal, albedo, mask, coverage = (
            planes.index_select(0, rows).float()
            for planes in (faces.normal, faces.albedo, faces.mask, faces.coverage)
        )
        image = self._relit(rows, lighting, flips)
        mirrored = torch.from_numpy(flips).to(image.device)
        image, albedo, mask, coverage = (
            _reflected(planes, mirrored, mirror_map) for planes in (image, albedo, mask, coverage)
        )
        normal = _renormalised(_reflected(normal, mirrored, mirror_normal))
        image = simulate_photograph(image, coverage, behind, effects)
        mask = mask * frame_masks(effects, *pixels).to(mask.device)
        albedo, light = _as_seen(albedo, lighting.label, effects)
        return FaceBatch(image, normal, albedo, light.to(image.device), mask)

    def _relit(self, rows: Tensor, lighting: Lighting, flips: NDArray[np.bool_]) -> Tensor:
        """Linear images (B, 3, H, W) before reflection: the reflected picture is lit as ``lighting`` says."""
        faces = self.faces
        count = faces.transport.shape[1]
        parity = np.where(flips[:, None, None], x_parity(MAP_ORDER)[:, None], 1.0)
        radiance, irradiance = (
            torch.from_numpy(part.astype(np.float32)).to(faces.transport.device)
            for part in ((lighting.radiance * parity)[:, :count], lighting.irradiance)
        )
        responses = (faces.transport, faces.gloss, faces.directional)
        transport, gloss, lamps = (part.index_select(0, rows) for part in responses)
        return relight_batch(transport, radiance, gloss, lamps, irradiance)


def _as_seen(albedo: Tensor, label: Array, effects: list[PhotoEffects]) -> tuple[Tensor, Tensor]:
    """Albedo and light (B, 27) behind the photographs: the light has the camera's gain, both may be grey.

    A picture without colour does not tell that of the skin from that of the light, so the answer is grey too.
    """
    gains = np.array([effect.gain for effect in effects])
    light = label * gains[:, None]
    grey = np.array([effect.grey for effect in effects])
    light[grey] = (light[grey] @ LUMINANCE)[..., None]
    weights = albedo.new_tensor(LUMINANCE)[:, None, None]
    colourless = torch.from_numpy(grey).to(albedo.device)[:, None, None, None]
    albedo = torch.where(colourless, (albedo * weights).sum(1, keepdim=True), albedo)
    return albedo, torch.from_numpy(np.moveaxis(light, 1, 2).reshape(len(light), -1).astype(np.float32))


def _reflected(values: Tensor, flips: Tensor, reflect: Callable[[Tensor], Tensor]) -> Tensor:
    return torch.where(flips[:, None, None, None], reflect(values), values)


def _renormalised(normal: Tensor) -> Tensor:
    """Undo the rounding to half; where there is no surface the zero vector stays."""
    length = normal.square().sum(1, keepdim=True).sqrt()  # `norm` along this axis takes 50 times as long
    return torch.where(length > 0.5, normal / length.clamp_min(0.5), normal)
