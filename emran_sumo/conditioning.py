"""Path conditioning: a cut of a few centimeters that spares the heading error what the side slip would cost it."""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import solveh_banded

from emran_sumo.control.steering import SteeringParams, cornering_slip
from emran_sumo.kernels import njit
from emran_sumo.path import Path, shifted
from emran_sumo.plant.vehicle import VehicleParams

STEP = 0.5  # m between the unknowns
PENALTY = 3e5  # 1/m^2 on what exceeds the bound, against 1 / sigma_y^2 of the cut itself
ROUNDS = 40


@njit
def side_slip(params, vehicle, speed, curvature):
    """Side slip beta [rad] of the center of gravity in a steady turn, for curvatures (n,) [1/m] at `speed` [m/s]."""
    out = np.empty(curvature.size)
    for i in range(curvature.size):
        rear = cornering_slip(params, vehicle, speed * speed * curvature[i], True)
        out[i] = vehicle.rear_axle * curvature[i] - rear
    return out


def conditioned(path: Path, params: SteeringParams, vehicle: VehicleParams, speed: float) -> Path:
    """The path to drive instead of `path`, at most `cut_max` 10 / v beside it.

    In a bend the body must turn by the side slip beta against the path, so a car whose center of gravity follows the
    path exactly has a heading error of beta. The lateral offset d(s) trades the two:

        min  sum (d / sigma_y)^2 + ((beta - d') / sigma_psi)^2 + (w_j (kappa' + d'''))^2,   |d| <= cut_max 10 / v

    Args:
        path: Path.
        params: SteeringParams; `cut_*` are sigma_y [m], sigma_psi [rad], w_j [m^2] and the bound [m].
        vehicle: VehicleParams.
        speed: reference speed [m/s].
    """
    length = (path.x.size - 1) * path.spacing
    grid = np.linspace(0.0, length, max(int(length / STEP) + 1, 8))
    h = float(grid[1])
    position = np.arange(path.x.size) * path.spacing
    curvature = np.interp(grid, position, path.curvature)
    beta = side_slip(params, vehicle, float(speed), curvature)
    bound = params.cut_max * 10.0 / max(speed, 1.0)
    d = _solve(curvature, beta, h, bound, params)
    spline = CubicSpline(grid, d)
    return shifted(path, spline(position), spline(position, 1), spline(position, 2))


def _solve(curvature: np.ndarray, beta: np.ndarray, h: float, bound: float, params: SteeringParams) -> np.ndarray:
    n = curvature.size
    bands, right = np.zeros((4, n)), np.zeros(n)
    bands[0] += 1.0 / params.cut_sigma**2
    _add(bands, right, np.array([-1.0, 1.0]) / h, 0.5 * (beta[1:] + beta[:-1]), params.cut_heading_sigma**-2)
    bend_rate = -(curvature[2:-1] - curvature[1:-2]) / h
    _add(bands, right, np.array([-1.0, 3.0, -3.0, 1.0]) / h**3, bend_rate, params.cut_smoothness**2)
    active = np.zeros(n, dtype=bool)
    side = np.zeros(n)
    d = np.zeros(n)
    for _ in range(ROUNDS):
        held, target = bands.copy(), right.copy()
        held[0] += PENALTY * active
        target += PENALTY * active * bound * side
        d = solveh_banded(held, target, lower=True)
        beyond = np.abs(d) > bound
        if np.array_equal(beyond, active):
            break
        active, side = beyond, np.sign(d)
    return d


def _add(bands: np.ndarray, right: np.ndarray, stencil: np.ndarray, target: np.ndarray, weight: float) -> None:
    """Add weight * |difference(d) - target|^2 to the normal equations; row j touches unknowns j .. j + k - 1."""
    k, rows = stencil.size, target.size
    for i in range(k):
        right[i : i + rows] += weight * stencil[i] * target
        for j in range(i, k):
            bands[j - i, i : i + rows] += weight * stencil[i] * stencil[j]
