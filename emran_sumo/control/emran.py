"""EMRAN: a radial basis network that grows, corrects its winner by an extended Kalman filter, prunes and merges."""

import math

import numpy as np

from emran_sumo.control.mran import blend_blocks, joint_update, open_block
from emran_sumo.control.neurons import (
    DELETED,
    GROWN,
    LEARNED,
    MERGED,
    NEURONS,
    PRUNED,
    RESERVED,
    SAMPLES,
    EmranMemory,
    EmranParams,
    activation,
    blank_memory,
    gradient,
    initial_variance,
    predict,
    remove,
    variance_drift,
    winner,
)
from emran_sumo.kernels import njit

__all__ = [
    "DELETED", "GROWN", "LEARNED", "MERGED", "NEURONS", "PRUNED", "RESERVED", "SAMPLES", "EmranMemory", "EmranParams",
    "activation", "blank_memory", "fade", "gradient", "initial_variance", "learn", "learn_bias", "predict", "prune",
    "variance_drift",
]  # fmt: skip

# a network whose largest neuron contributes less than this says nothing about which neuron is idle
SILENT = 1e-4


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
    open_block(memory.joint, k, l, memory.covariance[k])
    for i in range(inputs.size):
        memory.centers[k, i] = inputs[i]
    memory.idle[k] = 0
    memory.age[k] = 0
    memory.counts[NEURONS] += 1
    memory.counts[GROWN] += 1


@njit
def _move(params, memory, k, pb, s, error):
    """Change weight, center and width of neuron k by `pb` (l,) / s * error, within their bounds."""
    move2 = 0.0
    for i in range(memory.centers.shape[1]):
        move2 += (pb[1 + i] / s * error) ** 2
    reach = params.center_step * memory.widths[k]
    shrink = min(1.0, reach / math.sqrt(move2)) if move2 > 0.0 else 1.0
    limit = params.output_max
    memory.weights[k] = min(max(memory.weights[k] + pb[0] / s * error, -limit), limit)
    for i in range(memory.centers.shape[1]):
        memory.centers[k, i] += shrink * pb[1 + i] / s * error
    width = memory.widths[k] + pb[memory.centers.shape[1] + 1] / s * error
    memory.widths[k] = min(max(width, params.width_min), params.width_max)


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
    _move(params, memory, k, pb, s, error)
    q = variance_drift(params, rate_scale, period)
    for i in range(l):
        for j in range(i + 1):
            value = p[i, j] - pb[i] * pb[j] / s
            if i == j:
                value += q if i == 0 else q * params.shape_gain
            p[i, j] = value
            p[j, i] = value


@njit
def _correct_all(params, memory, joint, inputs, error, rate_scale, period):
    """One extended Kalman filter update of all neurons (MRAN), within the same bounds as that of the winner."""
    l, n = inputs.size + 2, memory.counts[NEURONS]
    if params.unsigned:
        error = abs(error)
    b, pb, drift = np.empty(n * l), np.empty(n * l), np.empty(n * l)
    q = variance_drift(params, rate_scale, period)
    for k in range(n):
        gradient(memory, k, inputs, b[k * l : (k + 1) * l])
        drift[k * l : (k + 1) * l] = q * params.shape_gain
        drift[k * l] = q
    s = joint_update(joint, b, drift, pb)
    for k in range(n):
        first = k * l
        _move(params, memory, k, pb[first : first + l], s, error)
        memory.covariance[k] = joint[first : first + l, first : first + l]


@njit
def _update(params, memory, joint, k, inputs, error, rate_scale, period):
    """Correct the winner k, or all neurons where the network has a joint covariance."""
    if joint is not None:
        _correct_all(params, memory, joint, inputs, error, rate_scale, period)
    else:
        _correct(params, memory, k, inputs, error, rate_scale, period)


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

    Source: paper, Eq. 13-18; Li, Sundararajan, Saratchandran 2000; MRAN: Lu, Sundararajan, Saratchandran 1997.
    Differs: the second test of (13) is on |y_e|.
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
    k, distance = winner(memory, inputs)
    new = distance > eps and abs(error) >= params.error_grow and _window_rms(memory) >= params.rms_grow
    if new and counts[NEURONS] < params.neurons_max:
        _grow(params, memory, inputs, error, distance if k >= 0 else eps, rate_scale, period)
    elif k >= 0:
        _update(params, memory, memory.joint, k, inputs, error, rate_scale, period)
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
            remove(memory, k)
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
    blend_blocks(memory.joint, k, best, l, memory.counts[NEURONS])
    memory.idle[k] = 0
    remove(memory, best)
    memory.counts[MERGED] += 1
