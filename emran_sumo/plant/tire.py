"""Salaani's tire: longitudinal and lateral force of an axle from its slips, load and friction (Eq. 8)."""

import math
from typing import Annotated, NamedTuple

from pydantic import Field

from emran_sumo.kernels import njit
from emran_sumo.units import Unit

_QUARTER_PI = 0.25 * math.pi
_LARGEST_SLIP_RATIO = 0.99
_BISECTIONS = 42  # 0.14 rad / 2^42 is below 1e-13 rad


class TireParams(NamedTuple):
    """Tire parameters; stiffnesses are those at zero slip.

    Source: Table I (cornering stiffness); Salaani, SAE 2007-01-0816 (slip stiffness, sliding friction).
    Differs: friction alike in both directions; cornering stiffness independent of load, slip stiffness
    proportional to it. Sliding friction starts 5 % above `friction`, so that the peak stays near `friction`.
    """

    cornering_stiffness_front: Annotated[float, Field(gt=0), Unit("N/rad")] = 67_500.0
    cornering_stiffness_rear: Annotated[float, Field(gt=0), Unit("N/rad")] = 47_500.0
    tires_per_axle: Annotated[float, Field(ge=1, le=2), Unit("")] = 2.0  # 1: read Table I per axle
    slip_stiffness: Annotated[float, Field(gt=0, le=60), Unit("")] = 22.0  # C_kappa / F_z
    sliding_gain: Annotated[float, Field(gt=0, le=1.5), Unit("")] = 1.05
    sliding_decay: Annotated[float, Field(ge=0, le=0.95), Unit("")] = 0.4


@njit
def axle_stiffness(tire, rear):
    """Cornering stiffness of one axle at zero slip [N/rad]."""
    one = tire.cornering_stiffness_rear if rear else tire.cornering_stiffness_front
    return tire.tires_per_axle * one


@njit
def tire_forces(
    longitudinal_stiffness,
    cornering_stiffness,
    sliding_gain,
    sliding_decay,
    slip_ratio,
    tan_slip_angle,
    load,
    friction,
):
    """Force of an axle from adhesion and sliding, which share the demand.

        F_x = +F_z kappa     (C_kappa f_a / D_a + C_kappa,s f_s / D_s)
        F_y = -F_z tan alpha (C_alpha f_a / D_a + C_alpha   f_s / D_s)                           (8)

        D_a = |C_kappa kappa, C_alpha tan alpha| / mu_p      D_s = |C_kappa,s kappa, C_alpha tan alpha| / mu_s
        f_a = (4/pi) S / (1 + S^2)^2                         S = (pi/4) D_a / F_z
        f_s = (2/pi) (atan S - S (1 - S^2) / (1 + S^2)^2)
        mu_s = gain mu_p (1 - decay Slip)                    Slip^2 = sin^2 alpha + kappa^2 cos^2 alpha
        C_kappa,s = C_kappa + (C_alpha - C_kappa) Slip

    Args:
        longitudinal_stiffness: C_kappa of the axle [N], > 0.
        cornering_stiffness: C_alpha of the axle [N/rad], > 0.
        sliding_gain: mu_s / mu_p at the onset of sliding.
        sliding_decay: relative loss of sliding friction at Slip = 1, in [0, 1).
        slip_ratio: kappa, positive when driving; clamped to +-0.99.
        tan_slip_angle: tan(alpha), positive when the wheel drifts to the left.
        load: F_z [N]; no force where it is not positive.
        friction: mu_p; no force where it is not positive.

    Returns:
        (force_long, force_lat) [N] in wheel axes, along kappa and against alpha.

    Source: Debarshi et al., Eq. 8; Salaani, SAE 2007-01-0816, for elliptical pressure.
    Differs: signs in ISO axes; pi/4 in S, without which the stiffness at zero slip would be 4/pi of C; f_s
    written with atan, equal to Salaani's asin form but accurate at small slip.
    """
    if load <= 0.0 or friction <= 0.0:
        return 0.0, 0.0
    kappa = min(max(slip_ratio, -_LARGEST_SLIP_RATIO), _LARGEST_SLIP_RATIO)
    tan2 = tan_slip_angle * tan_slip_angle
    demand_lat = cornering_stiffness * tan_slip_angle
    demand_long = longitudinal_stiffness * kappa
    demand = math.sqrt(demand_long * demand_long + demand_lat * demand_lat)
    if demand < 1e-9:
        return demand_long, -demand_lat

    slip = math.sqrt((tan2 + kappa * kappa) / (1.0 + tan2))
    sliding_stiffness = longitudinal_stiffness + (cornering_stiffness - longitudinal_stiffness) * slip
    sliding_friction = sliding_gain * friction * (1.0 - sliding_decay * slip)
    demand_sliding_long = sliding_stiffness * kappa
    demand_sliding = math.sqrt(demand_sliding_long * demand_sliding_long + demand_lat * demand_lat)

    s = _QUARTER_PI * demand / (friction * load)
    s2 = s * s
    q = 1.0 / ((1.0 + s2) * (1.0 + s2))
    f_a = s * q / _QUARTER_PI
    f_s = 0.5 * (math.atan(s) - s * (1.0 - s2) * q) / _QUARTER_PI
    adhesion = friction * load * f_a / demand
    sliding = sliding_friction * load * f_s / demand_sliding
    return demand_long * adhesion + demand_sliding_long * sliding, -demand_lat * (adhesion + sliding)


@njit
def slip_angle_for_force(force, load, cornering_stiffness, sliding_gain, sliding_decay, friction, limit):
    """Slip angle at which a freely rolling axle gives a lateral force: the inverse of `tire_forces`.

    Args:
        force: wanted lateral force [N].
        load: F_z [N].
        cornering_stiffness: C_alpha of the axle [N/rad].
        sliding_gain: see `tire_forces`.
        sliding_decay: see `tire_forces`.
        friction: mu_p.
        limit: largest angle returned [rad], in (0, pi/2); meant to lie before the peak of the force.

    Returns:
        Angle [rad] with the sign of `force` (the ISO slip angle is its negative), in [-limit, limit];
        +-limit where the force is out of reach.
    """
    wanted = abs(force)
    low = 0.0
    high = limit
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        given = -tire_forces(
            cornering_stiffness,
            cornering_stiffness,
            sliding_gain,
            sliding_decay,
            0.0,
            math.tan(middle),
            load,
            friction,
        )[1]
        if given < wanted:
            low = middle
        else:
            high = middle
    return math.copysign(0.5 * (low + high) if high < limit else limit, force) if wanted > 0.0 else 0.0
