"""MRAN: one extended Kalman filter over the parameters of all neurons, where EMRAN has a small one for each.

The n neurons of a network have l parameters each; `joint` (H l, H l) holds their covariance, neuron k in the rows and
columns k l to (k + 1) l.  It is None in a network that corrects its winner alone.
"""

import numpy as np

from emran_sumo.kernels import njit


@njit
def joint_update(joint, b, drift, step):
    """Joint extended Kalman filter update of a scalar output.

        K = P B / (R + B' P B),   P = (I - K B') P + q I,   R = 1                                    (15)-(17)

    Args:
        joint: P, changed in place in its first m rows and columns.
        b: B (m,), gradient of the output with respect to all parameters.
        drift: q (m,), of each parameter.
        step: (m,), receives P B.

    Returns:
        R + B' P B, by which `step` is to be divided for K.
    """
    m = b.size
    s = 1.0
    for i in range(m):
        total = 0.0
        for j in range(m):
            total += joint[i, j] * b[j]
        step[i] = total
        s += b[i] * total
    for i in range(m):
        gain = step[i] / s
        for j in range(i + 1):
            value = joint[i, j] - gain * step[j]
            joint[i, j] = value
            joint[j, i] = value
        joint[i, i] += drift[i]
    return s


@njit
def open_block(joint, k, l, block):
    """Give neuron k the covariance `block` (l, l), without correlation with the others.

    P = [P 0; 0 P_0 I]                                                                               (18)
    """
    if joint is not None:
        first = k * l
        for i in range(first, first + l):
            for j in range(first + l):
                joint[i, j] = 0.0
                joint[j, i] = 0.0
            for j in range(l):
                joint[i, first + j] = block[i - first, j]


@njit
def drop_block(joint, k, last, l):
    """Forget neuron k; neuron `last` takes its place."""
    if joint is not None and k != last:
        n = (last + 1) * l
        for i in range(l):
            for j in range(n):
                joint[k * l + i, j] = joint[last * l + i, j]
        for i in range(n):
            for j in range(l):
                joint[i, k * l + j] = joint[i, last * l + j]


@njit
def blend_blocks(joint, k, other, l, n):
    """Let neuron k of n have the covariance of the mean of its parameters and those of `other`: P = M P M'."""
    if joint is not None:
        for i in range(k * l, (k + 1) * l):
            partner = i + (other - k) * l
            for j in range(n * l):
                joint[i, j] = 0.5 * (joint[i, j] + joint[partner, j])
        for j in range(k * l, (k + 1) * l):
            partner = j + (other - k) * l
            for i in range(n * l):
                joint[i, j] = 0.5 * (joint[i, j] + joint[i, partner])


def blank_joint(neurons: int, parameters: int) -> np.ndarray:
    """Covariance of a network that may have so many neurons."""
    return np.zeros((neurons * parameters, neurons * parameters))
