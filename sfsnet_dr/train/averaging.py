"""Means of the weights of several trainings that began alike.

A network that is trained on with other aims gains there and loses elsewhere. Weights on the line between it
and what it began with are networks too, often better than both ends, for both lie in one basin of the loss.

Source: Wortsman et al., Robust fine-tuning of zero-shot models, CVPR 2022, and Model soups, ICML 2022.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import torch

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.models.base import Network
from sfsnet_dr.models.inference import LoadedModel, load_model


def average_weights(paths: Sequence[Path | str], shares: Sequence[float] = ()) -> Network:
    """The network whose parameters and statistics are a mean of those of others, in evaluation mode.

    Args:
        paths: two files or shipped names at least, of one architecture, one set of settings and one view.
        shares: of each, above 0, in any unit; none for equal ones.

    Raises:
        InputError: for fewer than two, networks that differ, or shares that do not fit; as ``load_weights``.
    """
    if len(paths) < 2:
        raise InputError(f"weights: {len(paths)} found, a mean needs two files at least")
    parts = _as_parts(shares, len(paths))
    networks = [load_model(path) for path in paths]
    for path, network in zip(paths, networks, strict=True):
        if _kind(network) != _kind(networks[0]):
            raise InputError(
                f"{path}: {_kind(network)} found, {_kind(networks[0])} in {paths[0]}; only networks of one "
                "kind have a mean"
            )
    states = [network.model.state_dict() for network in networks]
    mean = {}
    for name, last in states[-1].items():
        if last.is_floating_point():
            sums = [part * state[name].double() for part, state in zip(parts, states, strict=True)]
            mean[name] = torch.stack(sums).sum(0).to(last.dtype)
        else:  # counts of batches, which nothing is computed from
            mean[name] = last
    networks[-1].model.load_state_dict(mean)
    return networks[-1].model


def _as_parts(shares: Sequence[float], count: int) -> list[float]:
    """Shares that sum to 1."""
    given = tuple(shares) or (1.0,) * count
    if len(given) != count:
        raise InputError(f"shares: {len(given)} found for {count} files of weights; give one for each")
    if not all(math.isfinite(share) and share > 0 for share in given):
        raise InputError(f"shares: {', '.join(map(str, given))} found, finite numbers above 0 are allowed")
    return [share / sum(given) for share in given]


def _kind(network: LoadedModel) -> str:
    """What networks with a mean have in common, in words."""
    model, view = network.model, network.crop
    own = "".join(f", {key} = {value}" for key, value in sorted(model.config.items()))
    return f"a {model.architecture} that sees {view.crop} pixels as {view.size}, {network.encoding}{own}"
