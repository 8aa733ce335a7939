"""Least squares of a hundred unknowns, compiled."""

import math

import numpy as np

from emran_sumo.kernels import njit


@njit
def normal_equations(slopes, residuals):
    """J^T J (n, n) and J^T r (n,) of slopes J (m, n) and residuals r (m,).

    The threads of a BLAS, which wait for each other, cost far more than matrices of this size.
    """
    rows, n = slopes.shape
    matrix, downhill = np.zeros((n, n)), np.zeros(n)
    for k in range(rows):
        for i in range(n):
            if slopes[k, i] != 0.0:
                downhill[i] += slopes[k, i] * residuals[k]
                for j in range(i + 1):
                    matrix[i, j] += slopes[k, i] * slopes[k, j]
    for i in range(n):
        for j in range(i):
            matrix[j, i] = matrix[i, j]
    return matrix, downhill


@njit
def solved(matrix, right):
    """x (n,) with A x = b of a positive definite A (n, n), by Cholesky's factors, which are left in A."""
    n = right.size
    x = right.copy()
    for i in range(n):
        for j in range(i + 1):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = rest / matrix[j, j] if j < i else math.sqrt(max(rest, 1e-12))
    for i in range(n):
        for k in range(i):
            x[i] -= matrix[i, k] * x[k]
        x[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= matrix[k, i] * x[k]
        x[i] /= matrix[i, i]
    return x
