"""Image files in and out by OpenImageIO: photographs as linear light, EXR with named channels.

Convention:
    Arrays are (H, W, C), row 0 on top, linear Rec. 709 primaries. Files of integer samples (PNG, JPEG, TIFF)
    hold sRGB-encoded values unless they declare themselves linear; files of float samples (EXR, HDR) hold
    linear light. An embedded ICC profile is not applied.
"""

from __future__ import annotations

import zlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfsnet_dr.core.color import linear_to_srgb, srgb_to_linear
from sfsnet_dr.core.errors import InputError, RunError
from sfsnet_dr.core.files import atomic_path

_PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_PNG_END: Final = b"IEND\xaeB`\x82"
_HALF_MAX: Final = 65504.0


@dataclass(frozen=True, eq=False)
class Image:
    """A decoded picture.

    Attributes:
        pixels: (H, W, C) float32, linear light, C = 1 (grey) or 3.
        metadata: what the file says beside its pixels: names to strings or numbers.
        was_srgb: whether the file's values were decoded with the sRGB curve.
    """

    pixels: NDArray[np.float32]
    metadata: dict[str, Any]
    was_srgb: bool


def read_image(path: Path | str, channels: int | None = None) -> Image:
    """Read a picture as linear light, upright as its Exif orientation says.

    Alpha is dropped. Colours are those of the surface, not those already multiplied by alpha: PNG stores them
    so, for EXR the multiplication is undone (and pixels of alpha 0 stay as stored).

    Args:
        path: PNG, JPEG, TIFF, EXR, HDR or what else OpenImageIO reads; of several images the first.
        channels: 3 turns grey into equal red, green and blue; None keeps 1 or 3 as the file has them.

    Raises:
        InputError: if the file is missing, empty, damaged or not an image, has other than 1, 3 or 4 channels,
            or holds NaN or inf.
    """
    import OpenImageIO as oiio

    path = Path(path)
    hints = oiio.ImageSpec()
    hints.attribute("oiio:UnassociatedAlpha", 1)
    pixels, spec = _decode(path, hints)
    if spec.nchannels not in (1, 3, 4):
        raise InputError(f"{path}: {spec.nchannels} channels found, 1 (grey), 3 (RGB) or 4 (RGBA) allowed")
    _check_finite(path, pixels)
    is_float = spec.format.basetype in (oiio.HALF, oiio.FLOAT, oiio.DOUBLE)
    was_srgb = not is_float and not spec.get_string_attribute("oiio:ColorSpace").startswith("lin")
    if pixels.shape[2] == 4:
        pixels = _without_alpha(pixels, premultiplied=is_float)
    if was_srgb:
        pixels = srgb_to_linear(pixels).astype(np.float32)
    if channels == 3 and pixels.shape[2] == 1:
        pixels = np.repeat(pixels, 3, axis=2)
    upright = _upright(pixels, spec.get_int_attribute("Orientation", 1))
    return Image(np.ascontiguousarray(upright), _metadata(spec), was_srgb)


def read_samples(path: Path | str) -> tuple[NDArray[np.float32], int]:
    """A file's values as they stand in it, for cameras whose 8-bit values are linear light already.

    Returns:
        (H, W, C) with C = 1 or 3, integers as shares of the largest one; and the bits of a sample.

    Raises:
        InputError: as ``read_image``.
    """
    import OpenImageIO as oiio

    path = Path(path)
    pixels, spec = _decode(path, oiio.ImageSpec())
    if spec.nchannels not in (1, 3):
        raise InputError(f"{path}: {spec.nchannels} channels found, 1 (grey) or 3 (RGB) allowed")
    return pixels, 8 * int(spec.format.basesize())


def write_png(
    path: Path | str, pixels: ArrayLike, metadata: Mapping[str, str] | None = None, *, encoded: bool = False
) -> None:
    """Write an 8-bit sRGB PNG, whole or not at all; equal pixels give equal bytes.

    Args:
        path: the file; its folder must exist.
        pixels: (H, W, 3) linear light, clipped to 0..1.
        metadata: strings to store as text.
        encoded: ``pixels`` are display values already (a normal map, a plot) and get no sRGB curve.

    Raises:
        InputError: if the shape is wrong, a value is not finite, or the file cannot be written.
    """
    import OpenImageIO as oiio

    array = np.asarray(pixels, dtype=np.float64)
    if array.ndim != 3 or array.shape[2] != 3 or array.size == 0:
        raise InputError(f"{path}: pixels of shape {array.shape} found, (H, W, 3) expected")
    _check_finite(path, array)
    array = np.clip(array, 0, 1)
    display = array if encoded else linear_to_srgb(array)
    spec = oiio.ImageSpec(array.shape[1], array.shape[0], 3, oiio.UINT8)
    _write(Path(path), spec, np.rint(display * 255).astype(np.uint8), metadata or {})


def write_exr(
    path: Path | str,
    channels: Mapping[str, ArrayLike],
    metadata: Mapping[str, str],
    float32: Collection[str] = (),
) -> None:
    """Write named channels, half floats by default, whole or not at all; equal input gives equal bytes.

    Args:
        path: the file; its folder must exist.
        channels: names to (H, W) arrays of one shape.
        metadata: strings to store as attributes.
        float32: names of the channels to store as float32.

    Raises:
        InputError: if there is no channel, shapes differ, a value is not finite or exceeds half (65504),
            a name in ``float32`` is no channel, or the file cannot be written.
        RunError: if it cannot be written to its end, as on a full disk.
    """
    import OpenImageIO as oiio

    planes = {name: np.asarray(channels[name], dtype=np.float32) for name in channels}
    _check_planes(path, planes, float32)
    height, width = next(iter(planes.values())).shape
    # OpenImageIO reads the formats of single channels only where they differ.
    common = oiio.FLOAT if set(float32) == set(planes) else oiio.HALF
    spec = oiio.ImageSpec(width, height, len(planes), common)
    spec.channelnames = tuple(planes)
    spec.channelformats = tuple(oiio.TypeDesc("float" if name in float32 else "half") for name in planes)
    spec.attribute("compression", "zip")
    spec.attribute("DateTime", "")  # keeps OpenImageIO from writing the time of day
    _write(Path(path), spec, np.stack(list(planes.values()), axis=-1), metadata)


def read_exr(path: Path | str) -> tuple[dict[str, NDArray[np.float32]], dict[str, str]]:
    """Read all channels of an EXR, (H, W) float32 each, by name, and its attributes that are strings.

    Raises:
        InputError: if the file is missing, empty, damaged or not an EXR.
    """
    import OpenImageIO as oiio

    path = Path(path)
    pixels, spec = _decode(path, oiio.ImageSpec(), only="openexr")
    planes = {name: np.ascontiguousarray(pixels[..., c]) for c, name in enumerate(spec.channelnames)}
    return planes, {name: value for name, value in _metadata(spec).items() if isinstance(value, str)}


def _decode(path: Path, hints: Any, only: str | None = None) -> tuple[NDArray[np.float32], Any]:
    import OpenImageIO as oiio

    _check_bytes(path)
    source = oiio.ImageInput.open(str(path), hints)
    if source is None:
        raise InputError(f"{path}: cannot be decoded ({_one_line(oiio.geterror())}); give an image file")
    try:
        if only is not None and source.format_name() != only:
            raise InputError(f"{path}: {source.format_name()} file found, {only} expected")
        pixels, spec = source.read_image(oiio.FLOAT), source.spec()
        error = source.geterror()
    finally:
        source.close()
    if pixels is None or error:
        raise InputError(
            f"{path}: damaged, its pixels cannot be decoded ({_one_line(error)}); give a whole file"
        )
    return pixels.reshape(spec.height, spec.width, spec.nchannels), spec


def _check_bytes(path: Path) -> None:
    if path.is_dir():
        raise InputError(f"{path}: is a folder, an image file is needed")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give an existing image file") from error
    if not data:
        raise InputError(f"{path}: 0 bytes found, an image file is needed")
    if data.startswith(_PNG_SIGNATURE):
        _check_png(path, data)


def _check_png(path: Path, data: bytes) -> None:
    """Walk the chunks and their checksums, because libpng prints on standard error what it finds damaged."""
    at, kind = len(_PNG_SIGNATURE), b""
    while kind != b"IEND":
        end = at + 12 + int.from_bytes(data[at : at + 4], "big")
        kind, checksum = data[at + 4 : at + 8], data[end - 4 : end]
        if end > len(data) or zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(checksum, "big"):
            raise InputError(f"{path}: damaged or cut short (PNG chunk at byte {at}); give a whole file")
        at = end


def _check_finite(path: Path | str, pixels: NDArray[Any]) -> None:
    bad = int(np.count_nonzero(~np.isfinite(pixels)))
    if bad:
        raise InputError(
            f"{path}: NaN or inf in {bad} of {pixels.size} values, only finite values are allowed"
        )


def _check_planes(
    path: Path | str, planes: Mapping[str, NDArray[np.float32]], float32: Collection[str]
) -> None:
    shapes = {plane.shape for plane in planes.values()}
    if len(shapes) != 1 or any(len(shape) != 2 or 0 in shape for shape in shapes):
        raise InputError(f"{path}: channels of shapes {sorted(shapes)} found, one shape (H, W) expected")
    unknown = set(float32) - set(planes)
    if unknown:
        raise InputError(f"{path}: float32 names {sorted(unknown)}, which are no channels")
    for name, plane in planes.items():
        _check_finite(f"{path}: channel {name}", plane)
        largest = float(np.abs(plane).max())
        if name not in float32 and largest > _HALF_MAX:
            raise InputError(
                f"{path}: channel {name}: {largest:g} found, half floats reach {_HALF_MAX:g}: use float32"
            )


def _write(path: Path, spec: Any, pixels: NDArray[Any], metadata: Mapping[str, str]) -> None:
    import OpenImageIO as oiio

    for name, text in metadata.items():
        spec.attribute(name, text)
    with atomic_path(path) as partial:
        target = oiio.ImageOutput.create(str(partial))
        if target is None:
            raise InputError(f"{path}: {_one_line(oiio.geterror())}; use .png or .exr")
        # OpenImageIO refuses arrays whose channels do not lie side by side.
        done = target.open(str(partial), spec) and target.write_image(np.ascontiguousarray(pixels))
        if not (target.close() and done):
            raise RunError(f"{path}: writing failed ({_one_line(target.geterror())})")
        _check_end(partial, path)


def _check_end(written: Path, path: Path) -> None:
    """Prove that a file's last row can be read, for the end of a file can be lost without a word.

    OpenImageIO does not report it when a full disk cuts off no more than its last buffer.
    """
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(str(written))
    whole = False
    if source is not None:
        spec = source.spec()
        rows = source.read_scanlines(0, 0, spec.height - 1, spec.height, 0, 0, spec.nchannels, oiio.FLOAT)
        whole = rows is not None and not source.geterror()
        source.close()
    if written.suffix == ".png":
        whole = whole and written.read_bytes().endswith(_PNG_END)
    if not whole:
        oiio.geterror()  # else it would be taken for the next file's
        raise RunError(f"{path}: writing failed (the file is cut short); is the disk full?")


def _without_alpha(pixels: NDArray[np.float32], premultiplied: bool) -> NDArray[np.float32]:
    colours, alpha = pixels[..., :3], pixels[..., 3:]
    if not premultiplied:
        return colours
    return np.divide(colours, alpha, out=colours.copy(), where=alpha > 0)


def _upright(pixels: NDArray[np.float32], orientation: int) -> NDArray[np.float32]:
    """Turn by an Exif orientation, 1..8: transpose first (5 and above), then mirror rows and columns."""
    if orientation in (5, 6, 7, 8):
        pixels = pixels.transpose(1, 0, 2)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels


def _metadata(spec: Any) -> dict[str, Any]:
    return {attribute.name: attribute.value for attribute in spec.extra_attribs}


def _one_line(text: str) -> str:
    return " ".join(text.split()) or "no reason given"
