"""EMRAN: a radial basis network that grows, corrects its winner by an extended Kalman filter, prunes and merges."""

import math
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from emran_sumo.kernels import njit
from emran_sumo.units import Unit

# places in EmranMemory.counts
NEURONS, SAMPLES, LEARNED, DELETED, RESERVED, GROWN, PRUNED, MERGED = range(8)
# a network whose largest neuron contributes less than this says nothing about which neuron is idle
SILENT = 1e-4


class EmranParams(NamedTuple):
    """One EMRAN network with a single output, in the units of its learning signal (rad or m/s2).

    The paper's P_0, q and R appear as learning rates, which do not depend on the control period: while the winner is
    fully active its output follows the learning signal at `rate_initial` after birth and `rate_steady` later.

        P_0 = R l_0 T / (1 - l_0 T),   q = R (l_s T)^2 / (1 - l_s T),   R = 1

    neurons_max = 0 leaves the bias alone: an integrator of the learning signal. `unsigned` learns from the norm of
    the signal, as Eq. 15 is printed; it exists to show what that does.
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


class EmranMemory(NamedTuple):
    """What a network has learned; arrays changed in place.  H = neurons_max, s inputs, l = s + 2 parameters.

    centers (H, s), widths (H,), weights (H,), covariance (H, l, l) of [weight, center, width], idle (H,) samples
    without contribution, age (H,) samples, errors (window,) last learning signals, counts (8,), bias (1,),
    scale (1,) the distance eps_1 that makes an input new.
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
def _winner(memory, inputs):
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
def _grow(params, memory, inputs, error, distance, rate_scale, period):
    """Add a neuron at `inputs`.

        alpha = eta y_e,   mu = v,   sigma = kappa |v - mu_w|                                        (14)

    Differs: alpha is scaled by eta = growth_gain, because alpha = y_e doubles the feedback at once; the first neuron,
    which has no neighbor, takes the distance eps_1; the distance counts up to 3 eps_1, and sigma is held between
    width_min and width_max.
    """
    k = memory.counts[NEURONS]
    eps = memory.scale[0]
    memory.weights[k] = params.growth_gain * error
    memory.widths[k] = min(max(params.overlap * min(distance, 3.0 * eps), params.width_min), params.width_max)
    p0 = initial_variance(params, rate_scale, period)
    l = inputs.size + 2
    for i in range(l):
        for j in range(l):
            memory.covariance[k, i, j] = 0.0
        memory.covariance[k, i, i] = p0 if i == 0 else p0 * params.shape_gain
    for i in range(inputs.size):
        memory.centers[k, i] = inputs[i]
    memory.idle[k] = 0
    memory.age[k] = 0
    memory.counts[NEURONS] += 1
    memory.counts[GROWN] += 1


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
def _correct(params, memory, k, inputs, error, rate_scale, period):
    """One extended Kalman filter update of the winner, with the signed error.

        K = P B / (R + B' P B),   theta += K y_e,   P = (I - K B') P + q I,   R = 1                  (15)-(17)

    Differs: (15) prints the norm of the error, which learns in one direction only; `unsigned` does that. q is scaled by
    shape_gain for center and width, the center moves at most center_step widths at once, and weight and width are held
    within their bounds.
    """
    l = inputs.size + 2
    if params.unsigned:
        error = abs(error)
    b, pb = np.empty(l), np.empty(l)
    gradient(memory, k, inputs, b)
    p = memory.covariance[k]
    s = 1.0
    for i in range(l):
        pb[i] = 0.0
        for j in range(l):
            pb[i] += p[i, j] * b[j]
    for i in range(l):
        s += b[i] * pb[i]
    move2 = 0.0
    for i in range(inputs.size):
        move2 += (pb[1 + i] / s * error) ** 2
    reach = params.center_step * memory.widths[k]
    shrink = min(1.0, reach / math.sqrt(move2)) if move2 > 0.0 else 1.0
    limit = params.output_max
    memory.weights[k] = min(max(memory.weights[k] + pb[0] / s * error, -limit), limit)
    for i in range(inputs.size):
        memory.centers[k, i] += shrink * pb[1 + i] / s * error
    width = memory.widths[k] + pb[l - 1] / s * error
    memory.widths[k] = min(max(width, params.width_min), params.width_max)
    q = variance_drift(params, rate_scale, period)
    for i in range(l):
        for j in range(i + 1):
            value = p[i, j] - pb[i] * pb[j] / s
            if i == j:
                value += q if i == 0 else q * params.shape_gain
            p[i, j] = value
            p[j, i] = value


@njit
def _window_rms(memory):
    """RMS of the learning signals seen so far within the sliding window (Eq. 13, third test)."""
    n = min(memory.counts[SAMPLES], memory.errors.size)
    total = 0.0
    for i in range(n):
        total += memory.errors[i] ** 2
    return math.sqrt(total / n)


@njit
def learn(params, memory, inputs, error, rate_scale, period):
    """Learn one sample: delete it, keep it in reserve, add a neuron, or correct the winner.

        grow when |v - mu_w| > eps_1,  |y_e| >= error_grow,  rms over the window >= rms_grow         (13)

    Self-regulation: a sample below `error_delete` teaches nothing and is deleted; one below `error_learn` is left in
    reserve; only the others change the network.

    Args:
        params: EmranParams.
        memory: EmranMemory, changed in place.
        inputs: v (s,), scaled.
        error: y_e, the signed learning signal: what the network should have added.
        rate_scale: factor on the learning rates [-].
        period: control period [s].

    Returns:
        True when the sample was used; an empty network that does not grow stays empty all the same.

    Source: paper, Eq. 13-18; Li, Sundararajan, Saratchandran 2000.  Differs: the second test of (13) is on |y_e|.
    """
    counts = memory.counts
    memory.errors[counts[SAMPLES] % memory.errors.size] = error
    counts[SAMPLES] += 1
    eps = memory.scale[0]
    memory.scale[0] = max(eps * params.gamma, params.eps_min)
    if abs(error) < params.error_delete:
        counts[DELETED] += 1
        return False
    if abs(error) < params.error_learn:
        counts[RESERVED] += 1
        return False
    counts[LEARNED] += 1
    k, distance = _winner(memory, inputs)
    new = distance > eps and abs(error) >= params.error_grow and _window_rms(memory) >= params.rms_grow
    if new and counts[NEURONS] < params.neurons_max:
        _grow(params, memory, inputs, error, distance if k >= 0 else eps, rate_scale, period)
    elif k >= 0:
        _correct(params, memory, k, inputs, error, rate_scale, period)
        _merge(params, memory, k)
    return True


@njit
def learn_bias(params, memory, error, rate_scale, period):
    """Let the bias alpha_0 follow the learning signal at `bias_rate`, within +-output_max."""
    step = (1.0 - math.exp(-params.bias_rate * rate_scale * period)) * error
    memory.bias[0] = min(max(memory.bias[0] + step, -params.output_max), params.output_max)


@njit
def fade(memory, factor, bias_too):
    """Multiply all weights, and the bias where asked, by `factor`."""
    for k in range(memory.counts[NEURONS]):
        memory.weights[k] *= factor
    if bias_too:
        memory.bias[0] *= factor


@njit
def _remove(memory, k):
    """Drop neuron k; the last one takes its place."""
    last = memory.counts[NEURONS] - 1
    if k != last:
        memory.centers[k] = memory.centers[last]
        memory.widths[k] = memory.widths[last]
        memory.weights[k] = memory.weights[last]
        memory.covariance[k] = memory.covariance[last]
        memory.idle[k] = memory.idle[last]
        memory.age[k] = memory.age[last]
    memory.counts[NEURONS] = last


@njit
def prune(params, memory, inputs):
    """Remove neurons that for `prune_samples` samples in a row gave less than `prune_share` of the largest one.

    The last neuron stays, and so do neurons not older than `prune_samples`.
    """
    counts = memory.counts
    largest = 0.0
    for k in range(counts[NEURONS]):
        largest = max(largest, abs(memory.weights[k] * activation(memory, k, inputs)))
    for k in range(counts[NEURONS] - 1, -1, -1):
        memory.age[k] += 1
        share = abs(memory.weights[k] * activation(memory, k, inputs))
        memory.idle[k] = memory.idle[k] + 1 if share < params.prune_share * largest else 0
        idle_long = memory.idle[k] >= params.prune_samples and memory.age[k] > params.prune_samples
        if idle_long and largest > SILENT and counts[NEURONS] > 1:
            _remove(memory, k)
            counts[PRUNED] += 1


@njit
def _merge(params, memory, k):
    """Combine neuron k with the nearest one closer than `merge_distance`, keeping the output at the new center.

    Only neurons of like width (difference below half of the smaller) are combined.
    """
    s = memory.centers.shape[1]
    best, best_d2 = -1, params.merge_distance**2
    for j in range(memory.counts[NEURONS]):
        narrow = min(memory.widths[k], memory.widths[j])
        if j == k or abs(memory.widths[k] - memory.widths[j]) >= 0.5 * narrow:
            continue
        d2 = 0.0
        for i in range(s):
            d2 += (memory.centers[k, i] - memory.centers[j, i]) ** 2
        if d2 < best_d2:
            best, best_d2 = j, d2
    if best < 0:
        return
    a, b = memory.weights[k], memory.weights[best]
    share = abs(a) / (abs(a) + abs(b)) if abs(a) + abs(b) > 0.0 else 0.5
    center = np.empty(s)
    for i in range(s):
        center[i] = share * memory.centers[k, i] + (1.0 - share) * memory.centers[best, i]
    weight = a * activation(memory, k, center) + b * activation(memory, best, center)
    memory.weights[k] = min(max(weight, -params.output_max), params.output_max)
    memory.widths[k] = share * memory.widths[k] + (1.0 - share) * memory.widths[best]
    for i in range(s):
        memory.centers[k, i] = center[i]
    l = s + 2
    for i in range(l):
        for j in range(l):
            memory.covariance[k, i, j] = 0.5 * (memory.covariance[k, i, j] + memory.covariance[best, i, j])
    memory.idle[k] = 0
    _remove(memory, best)
    memory.counts[MERGED] += 1
