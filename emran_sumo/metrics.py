"""What a run was like, as pure functions of its trace: tracking, safety, comfort, networks."""

import math
from typing import NamedTuple

import numpy as np

from emran_sumo.loop import AT

# thresholds of a conflict, those of SUMO's SSM device
CONFLICT_TTC, CONFLICT_DRAC, CONFLICT_PET = 3.0, 3.0, 2.0  # s, m/s2, s
MOVING = 1.0  # m/s: slower, a time headway says nothing


class Box(NamedTuple):
    """Oriented rectangle: center [m], yaw [rad], length and width [m]."""

    x: float
    y: float
    yaw: float
    length: float
    width: float


class Lead(NamedTuple):
    """The vehicle ahead in the ego's corridor: bumper gap [m], time to collision [s], deceleration rate to avoid the
    crash [m/s2]; inf, inf and 0 without one."""

    gap: float
    time_to_collision: float
    deceleration_to_avoid: float


NO_LEAD = Lead(math.inf, math.inf, 0.0)


def tracking(trace: np.ndarray) -> dict[str, float]:
    """RMS and largest cross-track error [m], heading error [rad] and speed error [m/s] of a trace (n, columns)."""
    names = ("cross_track_error", "heading_error", "speed_error")
    found = {}
    for name in names:
        values = trace[:, getattr(AT, name)]
        found[f"{name}_rms"] = rms(values)
        found[f"{name}_max"] = largest(values)
    return found


def safety(trace: np.ndarray, gap: np.ndarray, ttc: np.ndarray, drac: np.ndarray) -> dict[str, float | int | None]:
    """Least time to collision [s], time headway [s] and gap [m], largest deceleration to avoid a crash [m/s2], and
    conflicts: how often the first or the last passed its threshold; None where nobody was ahead. Arrays (n,)."""
    speed = trace[:, AT.speed_long]
    headway = gap[speed > MOVING] / speed[speed > MOVING]
    return {
        "time_to_collision_min": _least(ttc),
        "time_headway_min": _least(headway),
        "gap_min": _least(gap),
        "deceleration_to_avoid_max": largest(drac),
        "conflicts": _episodes((ttc < CONFLICT_TTC) | (drac > CONFLICT_DRAC)),
    }


def _least(values: np.ndarray) -> float | None:
    low = values.min(initial=math.inf)
    return float(low) if math.isfinite(low) else None


def _episodes(flags: np.ndarray) -> int:
    """How often a flag was raised."""
    return int(np.count_nonzero(flags[1:] & ~flags[:-1]) + np.count_nonzero(flags[:1]))


def comfort(trace: np.ndarray) -> dict[str, float]:
    """RMS and largest acceleration [m/s2] and jerk [m/s3], along and across the car."""
    period = np.diff(trace[:, AT.time])
    found = {}
    for name in ("accel_lat", "accel_long"):
        values = trace[:, getattr(AT, name)]
        jerk = np.diff(values) / period
        for label, series in ((name, values), (name.replace("accel", "jerk"), jerk)):
            found[f"{label}_rms"] = rms(series)
            found[f"{label}_max"] = largest(series)
    return found


def effort(trace: np.ndarray) -> dict[str, float]:
    """Total variation of the steering command [rad] and of the acceleration command [m/s2]."""
    return {
        "steer_variation": float(np.abs(np.diff(trace[:, AT.steer_command])).sum()),
        "accel_variation": float(np.abs(np.diff(trace[:, AT.accel_command])).sum()),
    }


def networks(trace: np.ndarray) -> dict[str, float]:
    """Most and last number of neurons, and the share of samples that changed each network."""
    found = {}
    for name in ("speed", "steering"):
        count = trace[:, getattr(AT, f"neurons_{name}")]
        found[f"neurons_{name}_max"] = int(count.max(initial=0))
        found[f"neurons_{name}_end"] = int(count[-1]) if count.size else 0
        learned = trace[:, getattr(AT, f"learned_{name}")]
        found[f"learned_share_{name}"] = float(learned[-1] / learned.size) if count.size else 0.0
    return found


def rms(values: np.ndarray) -> float:
    """Root mean square; 0 of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else 0.0


def largest(values: np.ndarray) -> float:
    """Largest magnitude; 0 of nothing."""
    return float(np.abs(values).max(initial=0.0))


def lead(gap: float, speed: float, speed_ahead: float) -> Lead:
    """Lead measures of one pair.

        TTC = gap / (v - v_lead),   DRAC = (v - v_lead)^2 / (2 gap)   while closing

    Args:
        gap: bumper to bumper [m]; speed, speed_ahead: of ego and lead [m/s].

    Source: SUMO's SSM device (TTC, DRAC).
    """
    closing = speed - speed_ahead
    if closing <= 0.0:
        return Lead(gap, math.inf, 0.0)
    room = max(gap, 1e-3)
    return Lead(gap, room / closing, closing * closing / (2.0 * room))


def struck_where(own: Box, other: Box) -> str:
    """Who struck whom, by where the other's center lies, in words."""
    dx, dy = other.x - own.x, other.y - own.y
    ahead = dx * math.cos(own.yaw) + dy * math.sin(own.yaw)
    reach = 0.25 * (own.length + other.length)
    if ahead > reach:
        return "the ego ran into it"
    return "it ran into the ego" if ahead < -reach else "side by side"


def boxes_overlap(a: Box, b: Box) -> bool:
    """Whether two oriented rectangles share area (separating axis test)."""
    dx, dy = b.x - a.x, b.y - a.y
    if math.hypot(dx, dy) > 0.5 * (math.hypot(a.length, a.width) + math.hypot(b.length, b.width)):
        return False
    for box in (a, b):
        for angle in (box.yaw, box.yaw + 0.5 * math.pi):
            c, s = math.cos(angle), math.sin(angle)
            if abs(dx * c + dy * s) >= _reach(a, angle) + _reach(b, angle):
                return False
    return True


def _reach(box: Box, angle: float) -> float:
    """Half of the extent of a box along a direction."""
    turn = angle - box.yaw
    return 0.5 * (box.length * abs(math.cos(turn)) + box.width * abs(math.sin(turn)))
