"""Which figures the paper shows, by its numbers, and which case, rows and signals each is drawn from."""

from typing import NamedTuple

from emran_sumo.paper.cases import ACCURACY, MAIN
from emran_sumo.paper.rows import OWN, PLAIN


class Panel(NamedTuple):
    """One pair of axes.

    words: what it shows; axis: of the vertical one, with its unit; column: of the trace; reference: column drawn
    beside it, the same for all rows; steps: counts.
    """

    words: str
    axis: str
    column: str
    reference: str = ""
    steps: bool = False


class Plate(NamedTuple):
    """One figure of the paper.

    number: in the paper; name: of the files; caption; table: whose case is driven; cases: names of its cases, one row
    of panels each; rows: who drives, as the tables name them; window: (from, to) [s] shown, or the whole run.
    """

    number: int
    name: str
    caption: str
    table: str
    cases: tuple[str, ...]
    rows: tuple[str, ...]
    panels: tuple[Panel, ...]
    window: tuple[float, float] | None = None

    @property
    def stem(self) -> str:
        """File name without suffix."""
        return f"fig{self.number:02d}_{self.name}"


SPEED = Panel("speed profile", "speed (m/s)", "speed_long", "speed_reference")
SPEED_ERROR = Panel("speed error", "speed error (m/s)", "speed_error")
PATH = Panel("path profile", "lateral position y (m)", "y", "reference_y")
CROSS_TRACK = Panel("cross-track error", "cross-track error (m)", "cross_track_error")
HEADING = Panel("heading profile", "heading ψ (rad)", "yaw", "reference_yaw")
HEADING_ERROR = Panel("heading error", "heading error (rad)", "heading_error")
YAW_RATE = Panel("yaw rate", "yaw rate (rad/s)", "yaw_rate")
SPEED_LAT = Panel("lateral velocity", "lateral velocity (m/s)", "speed_lat")
STEER = Panel("steering angle", "road-wheel angle (rad)", "steer")
NEURONS_SPEED = Panel("neurons, cruise", "neurons", "neurons_speed", steps=True)
NEURONS_STEERING = Panel("neurons, steering", "neurons", "neurons_steering", steps=True)

DRIVERS = (PLAIN.name, OWN, ACCURACY, MAIN)  # the rows that are drawn, each with a color and dashes of its own
_CRUISE, _STEERING = (PLAIN.name, OWN, MAIN), DRIVERS
_ERRORS, _BOTH = (CROSS_TRACK, HEADING_ERROR), ("friction 1.2", "friction 1.0")
_RAMPS = ("ramp 0.28 m/s2", "ramp 1 m/s2")

PLATES = (
    Plate(5, "cruise_speed", "Cruise from 28 to 25 m/s without disturbance: speed and its error.", "III", _RAMPS,
          _CRUISE, (SPEED, SPEED_ERROR), (25.0, 50.0)),
    Plate(6, "cruise_neurons", "Neurons of the cruise network on the way from 28 to 25 m/s at 1 m/s².", "III",
          _RAMPS[1:], _CRUISE[1:], (NEURONS_SPEED,)),
    Plate(7, "hills_speed", "Cruise at 25 m/s over grades of +40 and -40 degrees: speed and its error.", "IV",
          ("transitions 0.3 s",), _CRUISE, (SPEED, SPEED_ERROR)),
    Plate(8, "hills_neurons", "Neurons of the cruise network over grades of +40 and -40 degrees.", "IV",
          ("transitions 0.3 s",), _CRUISE[1:], (NEURONS_SPEED,)),
    Plate(9, "lane_change_path", "Double lane change at 10 m/s: path and cross-track error.", "VI", ("nominal",),
          _STEERING, (PATH, CROSS_TRACK)),
    Plate(10, "lane_change_heading", "Double lane change at 10 m/s: heading and its error.", "VI", ("nominal",),
          _STEERING, (HEADING, HEADING_ERROR)),
    Plate(11, "lane_change_dynamics", "Double lane change at 10 m/s: yaw rate and lateral velocity.", "VI",
          ("nominal",), _STEERING, (YAW_RATE, SPEED_LAT)),
    Plate(12, "side_force_errors", "Double lane change at 10 m/s with a constant side force of 1500 N: errors.", "VII",
          ("+1500 N",), _STEERING, _ERRORS),
    Plate(13, "lane_change_steering", "Steering in the double lane change at 10 m/s.", "VI", ("nominal",), _STEERING,
          (STEER,)),
    Plate(14, "lane_change_neurons", "Neurons of the steering network in the double lane change at 10 m/s.", "VI",
          ("nominal",), _STEERING[1:], (NEURONS_STEERING,)),
    Plate(15, "fast_errors", "Double lane change at 20 m/s: errors.", "VIII", _BOTH, _STEERING, _ERRORS),
    Plate(16, "gust_errors", "Double lane change at 20 m/s with a side gust from t = 2 s on: errors.", "IX", _BOTH,
          _STEERING, _ERRORS),
)  # fmt: skip
