"""The double lane change of Eq. 23 on a road with other traffic: declared on a SUMO vehicle, begun in a free gap."""

import math
from typing import NamedTuple

import numpy as np

from emran_sumo.errors import UserError
from emran_sumo.path import LaneChange, Path, lane_change_offset, shifted
from emran_sumo.world.records import Others

# of Eq. 23: where the way out begins [m], the lengths of both transitions, and the distance between them
OUT_START, OUT_LENGTH, BACK_LENGTH = 27.19, 25.0, 21.95
HOLD = 56.46 - OUT_START - OUT_LENGTH
TAIL = 15.0  # m after the second transition until tanh has settled

CLOSING_AHEAD = 4.0  # s during which a slower leader comes closer
CLOSING_BEHIND = 3.0  # s until a faster follower has seen the ego and brakes
LEAST_GAP = 6.0  # m left after that, plus a time headway
HEADWAY = 0.4  # s
ACROSS = 2.0  # s until the ego is across
LEAST_ACROSS = 1.0  # m left after that


class DoubleLaneChange(NamedTuple):
    """One declared double lane change.

    start: position along the route [m] after which it may begin; lengths of the transitions [m]; side +1 left, -1
    right.
    """

    start: float
    length_out: float
    length_back: float
    side: int

    @property
    def back_start(self) -> float:
        """Distance [m] from its begin to where the way back begins."""
        return OUT_START + self.length_out + HOLD

    @property
    def length(self) -> float:
        """Distance [m] from its begin until the ego is back in its lane."""
        return self.back_start + self.length_back + TAIL


def declared(params: dict[str, str], ego: str) -> DoubleLaneChange | None:
    """The double lane change that the `<param>`s of a SUMO vehicle declare, if any.

    Raises:
        UserError: a value is not a number, or the direction is neither left nor right.
    """
    prefix = "double_lane_change."
    if prefix + "start" not in params:
        return None

    def number(key: str, default: float) -> float:
        text = params.get(prefix + key, str(default))
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and value > 0.0):
            raise UserError(f'vehicle "{ego}": param {prefix}{key}: found "{text}"; accepted is a number above 0 m.')
        return value

    direction = params.get(prefix + "direction", "left")
    if direction not in ("left", "right"):
        raise UserError(f'vehicle "{ego}": param {prefix}direction: found "{direction}"; accepted is left or right.')
    return DoubleLaneChange(
        number("start", 0.0),
        number("length_out", OUT_LENGTH),
        number("length_back", BACK_LENGTH),
        1 if direction == "left" else -1,
    )


def maneuver_path(base: Path, change: DoubleLaneChange, begin: float, width: float, back: float | None = None) -> Path:
    """The base path with the double lane change beginning at `begin` [m], over lanes `width` [m] apart.

    The way back begins `back` [m] later, else where the maneuver declares it; infinite: never.
    """
    position = np.arange(base.x.size) * base.spacing
    return shifted(base, *lane_change_offset(transitions(change, begin, width, back), position))


def transitions(
    change: DoubleLaneChange, begin: float, width: float, back: float | None = None
) -> tuple[LaneChange, LaneChange]:
    """Out and back (Eq. 23) as functions of the position [m] along the own lane; `back` as in maneuver_path."""
    height, back = change.side * width, change.back_start if back is None else back
    return (
        LaneChange(height, begin + OUT_START, change.length_out),
        LaneChange(-height, begin + back, change.length_back),
    )


def gap_is_free(change: DoubleLaneChange, others: Others, speed: float, length: float, width: float) -> bool:
    """Whether the lane beside, and the own lane to return to, leave everybody room to react.

    The follower in the own lane keeps its distance on its own: it sees the ego all the time.

    Args:
        change: the maneuver.
        others: traffic along the own lane's center line.
        speed, length: of the ego [m/s], [m].
        width: distance between the lanes' center lines [m].
    """
    beside = np.abs(others.offset - change.side * width) < 0.5 * width + 0.3
    own = np.abs(others.offset) < 0.5 * width
    gap = np.abs(others.ahead) - 0.5 * (others.length + length)
    front, rear = others.ahead >= 0.0, others.ahead < 0.0
    left_ahead = gap - np.maximum(speed - others.speed, 0.0) * CLOSING_AHEAD
    left_behind = gap - np.maximum(others.speed - speed, 0.0) * CLOSING_BEHIND
    blocked_ahead = (beside | own) & front & (left_ahead < LEAST_GAP + HEADWAY * speed)
    blocked_behind = beside & rear & (left_behind < LEAST_GAP + HEADWAY * others.speed)
    return not np.any(blocked_ahead | blocked_behind)


def lane_is_free(others: Others, speed: float, length: float, width: float) -> bool:
    """Whether nobody in the lane that `others` refers to comes too close before the ego is across.

    speed, length: of the ego [m/s], [m]; width: of the lane [m].
    """
    inside = np.abs(others.offset) < 0.5 * width
    gap = np.abs(others.ahead) - 0.5 * (others.length + length)
    closing = np.where(others.ahead > 0.0, speed - others.speed, others.speed - speed)
    return not np.any(inside & (gap - np.maximum(closing, 0.0) * ACROSS < LEAST_ACROSS))
