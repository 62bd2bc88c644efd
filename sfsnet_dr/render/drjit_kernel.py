"""One call of a kernel of ``drjit_lanes`` from torch: the kernel that fits, its inputs and its results.

f_render of one pixel and its adjoint, on Dr.Jit arrays: what the kernels compute, without the memory.

With n' = n / sqrt(max(|n|^2, e)), shapes P_k(n') and the light l_ck = scale_k L_ck:
image_c = albedo_c S_c, S_c = sum_k l_ck P_k. For upstream gradients g_c the adjoint is
d albedo_c = g_c S_c, d l_ck = g_c albedo_c P_k, and, with q_k = sum_c g_c albedo_c l_ck and
t = sum_k q_k grad P_k, d n = (t - n' <n', t>) / |n|, or t / sqrt(e) for shorter normals.
"""

from __future__ import annotations

import gc
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final, NamedTuple, cast

import torch
from torch import Tensor

from sfsnet_dr.core import runtime
from sfsnet_dr.core.conventions import NORMAL_EPSILON
from sfsnet_dr.render.drjit_interop import (
    PACKET,
    Layout,
    Types,
    make_view,
    packet_size,
    reshape_output,
    to_drjit,
    to_torch,
    types_of,
)
from sfsnet_dr.render.drjit_loop import GROUP, RUN, Lanes, Source, Structure, lanes, row_length
from sfsnet_dr.render.shading_numpy import COLOURS
from sfsnet_dr.scene.jit import dr
from sfsnet_dr.sh.polynomials import CONSTANT, Evaluator, basis_functions

#: |n|^2 above which a normal is shortened before it overflows, and the factor; by precision.
_LONG = ((1e36, 1e-20), (1e300, 1e-155))


def fold_batch(light: Sequence[Any]) -> list[Any]:
    """Light with the scales of the basis in it: 3K numbers, K of red, of green and of blue."""
    return [value * scale for value, scale in zip(light, _scales(len(light)), strict=True)]


class Shaded:
    """One pixel: its unit normal and the basis there, its shading, and the adjoint, colour by colour.

    Dr.Jit computes in the order in which this is traced. Finishing one colour before the next keeps fewer
    numbers alive, and a fifth of the instructions away that would move them to memory and back.
    """

    def __init__(self, normal: Sequence[Any], light: Sequence[Any]) -> None:
        """Normal: x, y, z of any length; light: ``fold_batch``."""
        self._order = math.isqrt(len(light) // COLOURS) - 1
        self._count = len(light) // COLOURS
        self._light = light
        self._normalise(normal)
        self._at = Evaluator(self._unit, dr.fma)
        self._basis = [self._at(f.shape) for f in basis_functions(self._order)]
        self._pull: list[Any] = [0.0] * self._count
        self._multiples: dict[tuple[int, float], Any] = {}

    def shading(self, colour: int) -> Any:
        """S of one colour."""
        light = self._light[colour * self._count :]
        total = light[0]  # the first basis function is constant, its shape is 1
        for k in range(1, self._count):
            total = dr.fma(self._basis[k], light[k], total)
        return total

    def send(self, colour: int, weight: Any, sums: list[Any]) -> None:
        """Carry d loss / d S of one colour on to the light and the normal.

        Args:
            sums: 3K sums over pixels of d loss / d folded light; this pixel's are added.
        """
        first = colour * self._count
        sums[first] = sums[first] + weight
        for k in range(1, self._count):
            sums[first + k] = dr.fma(weight, self._basis[k], sums[first + k])
            self._pull[k] = dr.fma(weight, self._light[first + k], self._pull[k])

    def normal_gradient(self) -> list[Any]:
        """d loss / d normal, of what has been sent."""
        tangent = [self._along(axis) for axis in range(3)]
        x, y, z = self._unit
        radial = dr.fma(tangent[0], x, dr.fma(tangent[1], y, tangent[2] * z))
        radial = dr.select(self._clamped, 0, radial)
        return [dr.fma(-radial, u, t) * self._inverse for u, t in zip(self._unit, tangent, strict=True)]

    def _normalise(self, normal: Sequence[Any]) -> None:
        x, y, z = normal
        longest, factor = _LONG[dr.float64_array_t(type(x)) is type(x)]
        shorten = dr.select(_squared(x, y, z) > longest, factor, 1)
        x, y, z = x * shorten, y * shorten, z * shorten
        squared = _squared(x, y, z)
        # An infinite component makes all three NaN, as in the other forms; else the finite two would be 0.
        inverse = dr.select(squared == dr.inf, dr.nan, dr.rsqrt(dr.maximum(squared, NORMAL_EPSILON)))
        self._clamped = squared < NORMAL_EPSILON
        self._unit = (x * inverse, y * inverse, z * inverse)
        self._inverse = inverse * shorten

    def _along(self, axis: int) -> Any:
        total: Any = 0.0
        for k, function in enumerate(basis_functions(self._order)):
            slope = function.slopes[axis]
            if len(slope.terms) == 1:
                ((powers, coefficient),) = slope.terms
                pull = self._times(k, coefficient)
                total = pull + total if powers == CONSTANT else dr.fma(pull, self._at.monomial(powers), total)
            elif slope.terms:
                total = dr.fma(self._pull[k], self._at(slope), total)
        return total

    def _times(self, k: int, coefficient: float) -> Any:
        """A multiple of one pull; 2 and -2 times it are one product."""
        size = abs(coefficient)
        if (k, size) not in self._multiples:
            self._multiples[k, size] = self._pull[k] if size == 1 else self._pull[k] * size
        product = self._multiples[k, size]
        return product if coefficient > 0 else -product


def unfold_batch(sums: Sequence[Any]) -> list[Any]:
    """Gradients by the light itself from gradients by the folded one."""
    return [value * scale for value, scale in zip(sums, _scales(len(sums)), strict=True)]


def _scales(count: int) -> list[float]:
    order = math.isqrt(count // COLOURS) - 1
    return [f.scale for f in basis_functions(order)] * COLOURS


def _squared(x: Any, y: Any, z: Any) -> Any:
    return dr.fma(x, x, dr.fma(y, y, z * z))


#: Recordings of one frozen function, one for each structure of a call, above which the oldest is dropped.
RECORDINGS: Final = 64

#: Frozen functions are recorded and replayed by one thread at a time.
_LOCK = threading.Lock()


class Signature(NamedTuple):
    """What a kernel has to be compiled for.

    Attributes:
        kinds: Dr.Jit's types for the tensors' device and dtype.
        packet: numbers in a packet.
        light_size: coefficients of an image's light.
        layouts: of the images that it reads.
    """

    kinds: Types
    packet: int
    light_size: int
    layouts: tuple[Layout, ...]

    def load_light(self, lanes: Lanes, light: Source) -> list[Any]:
        """In a kernel: the folded light of each lane's image."""
        first = lanes.image * light.image_step
        return fold_batch(
            [dr.gather(self.kinds.value, light.values, first + k) for k in range(self.light_size)]
        )

    def reads(self, sources: Sequence[Source]) -> list[tuple[Layout, Source]]:
        """In a kernel: its sources with their layouts."""
        return list(zip(self.layouts, sources, strict=True))


class Call:
    """A kernel's inputs: images (B, C, H, W) of one shape but for C, and light (B, 3K), all of one dtype."""

    def __init__(
        self,
        images: Sequence[Tensor],
        light: Tensor,
        dense: int = 0,
        *,
        packet: int = PACKET,
        run: int = RUN,
    ) -> None:
        """``dense``: how many of the last images have to lie without gaps; packet, run: for experiments.

        Raises:
            InputError: for a device or dtype that Dr.Jit does not have, or in a process that was forked after
                Dr.Jit had started.
        """
        runtime.check_process()
        first = images[0]
        self._shape, self._images, self._run = tuple(first.shape), images, run
        pixels = first.shape[2] * first.shape[3]
        kinds, packet = types_of(first.device.type, first.dtype), packet_size(pixels, packet)
        views = [make_view(x, packet, dense=k >= len(images) - dense) for k, x in enumerate(images)]
        self.signature = Signature(kinds, packet, light.shape[1], tuple(v.layout for v in views))
        one, light_step = _light(light)
        flat = [*(v.values for v in views), one]
        self._arrays = [to_drjit(x, kinds.value) for x in flat]
        places = [x.data_ptr() for x in flat]
        self._structure = Structure(
            batch=first.shape[0],
            packets=pixels // packet,
            run=run,
            sums=0,
            steps=(*((v.image_step, v.channel_step) for v in views), (light_step, 1)),
            same=tuple(places.index(place) for place in places),
        )

    def launch(self, kernel: Callable[..., Any], sums: int, *arguments: Any) -> list[Any]:
        """Run ``kernel(lanes, sources, light, *arguments)`` to its end, from any thread.

        Args:
            kernel: ``freeze_kernel``, returns a list of arrays.
            sums: how many numbers it sums over each image.
        """
        structure = self._structure._replace(sums=sums)
        if self._images[0].device.type == "cuda":  # Dr.Jit computes on a stream of its own
            torch.cuda.current_stream(self._images[0].device).synchronize()
        with _LOCK, _no_collection():
            which = lanes(self.signature.kinds, structure)
            results: list[Any] = kernel(structure, which, self._arrays, *arguments)
            dr.eval(results)
            dr.sync_thread()
        return results

    def image(self, like: int, array: Any) -> Tensor:
        """A result as (B, C, H, W), in the layout of one of the images."""
        return reshape_output(self.signature.layouts[like], to_torch(array), self._shape)

    def per_image(self, sums: Any, count: int) -> Tensor:
        """What the kernel summed, (B, count)."""
        return to_torch(sums).view(self._shape[0], GROUP, row_length(count)).sum(1)[:, :count]


def freeze_kernel(kernel: Callable[..., list[Any]]) -> Callable[..., list[Any]]:
    """Record a kernel's launches once for each structure of a call, and replay them afterwards.

    Args:
        kernel: (lanes, sources, light, *arguments) -> arrays.
    """

    def recorded(_: Structure, lanes: tuple[Any, ...], arrays: list[Any], *rest: Any) -> list[Any]:
        known = Lanes(*lanes)
        *sources, light = [known.source(k, values) for k, values in enumerate(arrays)]
        return kernel(known, sources, light, *rest)

    replayed = dr.freeze(recorded, limit=RECORDINGS, warn_after=10**6)

    def call(structure: Structure, lanes: Lanes, arrays: list[Any], *rest: Any) -> list[Any]:
        # Dr.Jit looks for arrays in plain tuples and lists, and compares named tuples as a whole.
        return cast(list[Any], replayed(structure, tuple(lanes), arrays, *rest))

    return call


def _light(light: Tensor) -> tuple[Tensor, int]:
    """Flat light, and the step to the next image's. One that is expanded is not copied for each image."""
    one = (light[:1] if light.stride(0) == 0 else light).contiguous()
    return one.view(-1), 0 if one.shape[0] == 1 else one.shape[1]


@contextmanager
def _no_collection() -> Iterator[None]:
    """Keep the garbage collector from freeing shared memory amid a recording, which ends the process."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def strip_subclass(x: Tensor) -> Tensor:
    """A parameter or another subclass as what it is in memory, differentiably."""
    return x if type(x) is Tensor else x.as_subclass(Tensor)
