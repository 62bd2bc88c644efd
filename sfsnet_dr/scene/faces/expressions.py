"""Seeded expressions and gaze as weights of ARKit-style face units, for every model that has such units."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sfsnet_dr.scene.spec import HeadSpec

Array = npt.NDArray[np.float64]
Units = dict[str, float]

# Units that move together, with their greatest strength. One group at most out of each row, so that lips are
# never asked to smile and to pout at once; the limits are where lips and lids begin to cross on either model.
_UPPER: tuple[Units, ...] = (
    {"browInnerUp": 0.7, "browOuterUp": 0.6, "eyeWide": 0.2},
    {"browDown": 0.8, "eyeSquint": 0.3, "noseSneer": 0.3},
    {"browInnerUp": 0.8, "browDown": 0.2},
    {"eyeSquint": 0.6, "cheekSquint": 0.4},
    {"eyeBlink": 0.35},
)
_MOUTH: tuple[Units, ...] = (
    {"mouthSmile": 0.9, "cheekSquint": 0.5, "eyeSquint": 0.3},
    {"mouthSmile": 0.7, "mouthUpperUp": 0.4, "mouthLowerDown": 0.25, "cheekSquint": 0.4, "jawOpen": 0.08},
    {"mouthFrown": 0.7, "mouthShrugLower": 0.3},
    {"mouthPucker": 0.6},
    {"mouthStretch": 0.5, "mouthLowerDown": 0.3, "jawOpen": 0.05},
    {"mouthDimple": 0.7, "mouthPress": 0.4},
    {"noseSneer": 0.5, "mouthUpperUp": 0.3, "jawOpen": 0.05},
)
_JAW: tuple[Units, ...] = ({"jawOpen": 0.45}, {"jawOpen": 0.25, "mouthFunnel": 0.3})

_ROWS = (
    (_UPPER, 0.5),
    (_MOUTH, 0.6),
    (_JAW, 0.25),
)  # with the probability of each when there is an expression

#: Standard deviation and limit of the gaze, as part of the full turn of a unit (25 to 30 degrees).
_GAZE_SPREAD, _GAZE_LIMIT = 0.22, 0.5


#: An open smile; as in ``_MOUTH``.
_SMILE: Units = _MOUTH[1]


def sample_expression(names: tuple[str, ...], rng: np.random.Generator, head: HeadSpec) -> Array:
    """Weights (len(names),) in [0, 1] of the expression that a scene asks for: its smile, or a random one."""
    if head.smile is None:
        return expression_weights(names, rng, head.expression)
    both = {unit: head.smile * greatest for unit, greatest in _SMILE.items()}
    return np.asarray(sum(_spread(names, unit, value, value) for unit, value in both.items()))


def expression_weights(names: tuple[str, ...], rng: np.random.Generator, probability: float) -> Array:
    """Weights of a random expression of up to three groups, left and right alike but for a little.

    Args:
        names: face units; a side is told by ``Left``, ``Right``, ``_L`` or ``_R`` at the end.
        rng: the only source of randomness.
        probability: of any expression; the rest keep a neutral face.

    Returns:
        (len(names),) in [0, 1].
    """
    value = np.zeros(len(names))
    active = rng.random() < probability
    for groups, chance in _ROWS:
        group = groups[int(rng.integers(len(groups)))]
        amount = rng.uniform(0.2, 1.0) * (rng.random() < chance) * active
        for unit, greatest in group.items():
            both = greatest * amount
            value += _spread(names, unit, both * rng.uniform(0.85, 1.15), both * rng.uniform(0.85, 1.15))
    return np.clip(value, 0.0, 1.0)


def gaze_weights(names: tuple[str, ...], rng: np.random.Generator, rest: tuple[float, float]) -> Array:
    """Weights that turn both eyes to one direction near the viewer, with lids at rest.

    Args:
        names: face units, as above.
        rng: the only source of randomness.
        rest: range of the blink at rest: the lids of one model's neutral face are wider open than another's.

    Returns:
        (len(names),) in [0, 1].
    """
    right, up = np.clip(_GAZE_SPREAD * rng.normal(size=2) * (1.0, 0.6), -_GAZE_LIMIT, _GAZE_LIMIT)
    # The person's left eye is on the image right.
    value = _spread(names, "eyeLookOut", max(right, 0.0), max(-right, 0.0))
    value += _spread(names, "eyeLookIn", max(-right, 0.0), max(right, 0.0))
    value += _spread(names, "eyeLookUp", max(up, 0.0), max(up, 0.0))
    value += _spread(names, "eyeLookDown", max(-up, 0.0), max(-up, 0.0))
    closed = float(rng.uniform(*rest))
    return np.clip(value + _spread(names, "eyeBlink", closed, closed), 0.0, 1.0)


def _spread(names: tuple[str, ...], unit: str, left: float, right: float) -> Array:
    """A unit's strength on the person's left and right; units without sides get the mean."""
    strength = {unit: 0.5 * (left + right)}
    strength |= {unit + end: left for end in ("Left", "_L")} | {unit + end: right for end in ("Right", "_R")}
    return np.array([strength.get(name, 0.0) for name in names])
