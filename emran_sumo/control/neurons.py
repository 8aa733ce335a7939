"""A network of Gaussian neurons: its parameters, what it has learned, its output and its gradient."""

import math
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from emran_sumo.control.mran import blank_joint, drop_block
from emran_sumo.kernels import njit
from emran_sumo.units import Unit

# places in EmranMemory.counts
NEURONS, SAMPLES, LEARNED, DELETED, RESERVED, GROWN, PRUNED, MERGED = range(8)


class EmranParams(NamedTuple):
    """One EMRAN network with a single output, in the units of its learning signal (rad or m/s2).

    The paper's P_0, q and R appear as learning rates, which do not depend on the control period: while the winner is
    fully active its output follows the learning signal at `rate_initial` after birth and `rate_steady` later.

        P_0 = R l_0 T / (1 - l_0 T),   q = R (l_s T)^2 / (1 - l_s T),   R = 1

    neurons_max = 0 leaves the bias alone: an integrator of the learning signal. `unsigned` learns from the norm of
    the signal, as Eq. 15 is printed; it exists to show what that does. `all_neurons` corrects all neurons by one filter
    (MRAN) in place of the winner alone; it exists to show what that costs.
    """

    authority: Annotated[float, Field(ge=0, le=1), Unit("-")] = 1.0
    eps_max: Annotated[float, Field(gt=0, le=100), Unit("-")] = 3.422
    eps_min: Annotated[float, Field(gt=0, le=100), Unit("-")] = 2.562
    gamma: Annotated[float, Field(gt=0, le=1), Unit("-")] = 0.98
    error_delete: Annotated[float, Field(ge=0, le=10), Unit("signal")] = 0.00055
    error_learn: Annotated[float, Field(ge=0, le=10), Unit("signal")] = 0.00111
    error_grow: Annotated[float, Field(ge=0, le=10), Unit("signal")] = 0.00051
    rms_grow: Annotated[float, Field(ge=0, le=10), Unit("signal")] = 0.00026
    window: Annotated[int, Field(ge=1, le=1000), Unit("samples")] = 14
    overlap: Annotated[float, Field(gt=0, le=10), Unit("-")] = 1.358
    growth_gain: Annotated[float, Field(ge=0, le=1), Unit("-")] = 0.262
    rate_initial: Annotated[float, Field(ge=0, le=90), Unit("1/s")] = 2.947
    rate_steady: Annotated[float, Field(ge=0, le=90), Unit("1/s")] = 2.673
    shape_gain: Annotated[float, Field(ge=0, le=1), Unit("-")] = 1.0
    bias_rate: Annotated[float, Field(ge=0, le=90), Unit("1/s")] = 0.979
    leak: Annotated[float, Field(ge=0, le=10), Unit("1/s")] = 0.0093
    width_min: Annotated[float, Field(gt=0, le=100), Unit("-")] = 0.02
    width_max: Annotated[float, Field(gt=0, le=100), Unit("-")] = 100.0
    center_step: Annotated[float, Field(ge=0, le=10), Unit("widths")] = 0.5
    output_max: Annotated[float, Field(gt=0, le=100), Unit("signal")] = 0.15
    prune_share: Annotated[float, Field(ge=0, lt=1), Unit("-")] = 0.037
    prune_samples: Annotated[int, Field(ge=1, le=100_000), Unit("samples")] = 81
    merge_distance: Annotated[float, Field(ge=0, le=100), Unit("-")] = 0.77
    neurons_max: Annotated[int, Field(ge=0, le=200), Unit("neurons")] = 40
    unsigned: Annotated[bool, Unit("on/off")] = False
    all_neurons: Annotated[bool, Unit("on/off")] = False


class EmranMemory(NamedTuple):
    """What a network has learned; arrays changed in place.  H = neurons_max, s inputs, l = s + 2 parameters.

    centers (H, s), widths (H,), weights (H,), covariance (H, l, l) of [weight, center, width], idle (H,) samples
    without contribution, age (H,) samples, errors (window,) last learning signals, counts (8,), bias (1,),
    scale (1,) the distance eps_1 that makes an input new.  joint (H l, H l): covariance over all neurons, whose
    diagonal blocks are those of `covariance`, where all neurons are corrected; None where the winner alone is.
    """

    centers: np.ndarray
    widths: np.ndarray
    weights: np.ndarray
    covariance: np.ndarray
    idle: np.ndarray
    age: np.ndarray
    errors: np.ndarray
    counts: np.ndarray
    bias: np.ndarray
    scale: np.ndarray
    joint: np.ndarray | None = None


def blank_memory(params: EmranParams, inputs: int) -> EmranMemory:
    """An empty network for `inputs` inputs."""
    h, l = params.neurons_max, inputs + 2
    return EmranMemory(
        np.zeros((h, inputs)),
        np.ones(h),
        np.zeros(h),
        np.zeros((h, l, l)),
        np.zeros(h, np.int64),
        np.zeros(h, np.int64),
        np.zeros(params.window),
        np.zeros(8, np.int64),
        np.zeros(1),
        np.full(1, params.eps_max),
        blank_joint(h, l) if params.all_neurons else None,
    )


@njit
def activation(memory, k, inputs):
    """Gaussian response of neuron k to `inputs` (s,).

    z = exp(-|v - mu|^2 / (2 sigma^2))                                                            (11)
    """
    d2 = 0.0
    for i in range(inputs.size):
        d2 += (inputs[i] - memory.centers[k, i]) ** 2
    return math.exp(-0.5 * d2 / (memory.widths[k] * memory.widths[k]))


@njit
def predict(params, memory, inputs):
    """Output of the network, bounded to +-output_max.

    u = alpha_0 + sum_k alpha_k z_k                                                               (12)
    """
    total = memory.bias[0]
    for k in range(memory.counts[NEURONS]):
        total += memory.weights[k] * activation(memory, k, inputs)
    return min(max(total, -params.output_max), params.output_max)


@njit
def winner(memory, inputs):
    """Index of the neuron nearest to `inputs` and its distance; (-1, inf) in an empty network."""
    best, best_d2 = -1, np.inf
    for k in range(memory.counts[NEURONS]):
        d2 = 0.0
        for i in range(inputs.size):
            d2 += (inputs[i] - memory.centers[k, i]) ** 2
        if d2 < best_d2:
            best, best_d2 = k, d2
    return best, math.sqrt(best_d2)


@njit
def initial_variance(params, rate_scale, period):
    """P_0 for which the first correction follows the signal at the rate `rate_initial`."""
    x = min(params.rate_initial * rate_scale * period, 0.9)
    return x / (1.0 - x)


@njit
def variance_drift(params, rate_scale, period):
    """q for which the corrections settle at the rate `rate_steady`."""
    x = min(params.rate_steady * rate_scale * period, 0.9)
    return x * x / (1.0 - x)


@njit
def gradient(memory, k, inputs, out):
    """B (l,): gradient of neuron k's output with respect to its weight, center and width, written to `out`.

    B = [z,  alpha z (v - mu) / sigma^2,  alpha z |v - mu|^2 / sigma^3]
    """
    z = activation(memory, k, inputs)
    a, w = memory.weights[k], memory.widths[k]
    d2 = 0.0
    for i in range(inputs.size):
        d = inputs[i] - memory.centers[k, i]
        d2 += d * d
        out[1 + i] = a * z * d / (w * w)
    out[0] = z
    out[1 + inputs.size] = a * z * d2 / (w * w * w)


@njit
def remove(memory, k):
    """Drop neuron k; the last one takes its place."""
    last = memory.counts[NEURONS] - 1
    if k != last:
        memory.centers[k] = memory.centers[last]
        memory.widths[k] = memory.widths[last]
        memory.weights[k] = memory.weights[last]
        memory.covariance[k] = memory.covariance[last]
        memory.idle[k] = memory.idle[last]
        memory.age[k] = memory.age[last]
    drop_block(memory.joint, k, last, memory.centers.shape[1] + 2)
    memory.counts[NEURONS] = last
