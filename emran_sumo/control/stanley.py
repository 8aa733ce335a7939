"""Stanley path tracking."""

import math

from emran_sumo.kernels import njit


@njit
def stanley(gain, softening, cross_track_error, heading_error, speed):
    """Steer toward the path.

        delta = psi_e + atan(k e / (k_s + v))                                                        (22)

    Args:
        gain: k [1/s].
        softening: k_s [m/s], keeps the angle finite at low speed.
        cross_track_error: e [m] at the reference point, positive when the path lies to the left.
        heading_error: psi_e [rad], path minus vehicle, in [-pi, pi).
        speed: v [m/s]; at least 0.1 m/s is assumed.

    Returns:
        Road-wheel angle [rad], positive to the left, not yet limited.

    Source: paper, Eq. 22; Hoffmann et al. 2007.  Differs: k_s added for low speed.
    """
    return heading_error + math.atan(gain * cross_track_error / (softening + max(speed, 0.1)))
