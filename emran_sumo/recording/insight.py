"""What is inside the networks, looked at twice a second: centers in input space, widths, weights, covariance."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import rerun as rr

from emran_sumo.control.emran import LEARNED, NEURONS, SAMPLES, EmranMemory
from emran_sumo.loop import AT, ControlParams, Networks
from emran_sumo.recording.colors import AMBER, GREEN, SLATE, TEAL, VIOLET, packed
from emran_sumo.recording.plots import ARCHETYPE, LINE_WIDTH
from emran_sumo.recording.stream import Stream, series

INSIGHT_PERIOD = 500  # ms
SHOWN = 16  # neurons of a network whose weights and widths are plotted
GRAVITY = 9.81  # m/s2
DRAWN = 0.2  # of its width is the radius of a neuron's sphere: whole ones would hide each other
_STEERING = [AT.cross_track_error, AT.heading_error, AT.speed_lat, AT.yaw_rate]
_SPEED = [AT.speed_reference, AT.accel_reference, AT.grade]
_CAR, _POSITIVE, _NEGATIVE = (packed([color])[0] for color in (AMBER, GREEN, SLATE))
COLORS = {"steering": VIOLET, "speed": TEAL}
# the three inputs that span the view of each network; the fourth of the steering network, the yaw rate, is not shown
AXES = {"steering": "cross-track error →, heading error ↑", "speed": "speed →, acceleration ↑"}


class Insight(NamedTuple):
    """One network at one instant.

    centers (n, s), widths (n,), weights (n,) of its n neurons; covariance: trace of P of the winner, NaN without one;
    share: of the samples that changed the network; point (s,): where in the input space the car is.
    """

    centers: np.ndarray
    widths: np.ndarray
    weights: np.ndarray
    covariance: float
    share: float
    point: np.ndarray


def insight(memory: EmranMemory, point: np.ndarray) -> Insight:
    """A copy of what the network is now; the winner is the neuron nearest to `point`."""
    n = int(memory.counts[NEURONS])
    centers = memory.centers[:n].copy()
    covariance = np.nan
    if n:
        away = centers - point
        covariance = float(memory.covariance[int((away * away).sum(axis=1).argmin())].trace())
    share = float(memory.counts[LEARNED] / max(memory.counts[SAMPLES], 1))
    return Insight(centers, memory.widths[:n].copy(), memory.weights[:n].copy(), covariance, share, point)


def insights(control: ControlParams, networks: Networks, row: np.ndarray) -> Iterator[tuple[str, Insight]]:
    """The networks that act, by name, where a look is due at the time of the trace row."""
    if round(float(row[AT.time]) * 1e3) % INSIGHT_PERIOD:
        return
    if control.lateral.emran.authority > 0.0:
        yield "steering", insight(networks.steering, steering_point(control, row))
    if control.longitudinal.emran.authority > 0.0:
        yield "speed", insight(networks.speed, speed_point(control, row))


def steering_point(control: ControlParams, row: np.ndarray) -> np.ndarray:
    """Inputs (4,) of the steering network as a trace row gives them, without the noise of the sensors."""
    p = control.lateral
    if not p.feedforward:
        return row[[AT.y, AT.yaw, AT.speed_lat, AT.yaw_rate]]
    cross_track, heading, speed_lat, yaw_rate = row[_STEERING].tolist()
    cross_track += p.reference_ahead * math.sin(heading)
    return np.array(
        (
            p.cross_track_scale * cross_track,
            p.heading_scale * heading,
            p.speed_lat_scale * speed_lat,
            p.yaw_rate_scale * yaw_rate,
        )
    )


def speed_point(control: ControlParams, row: np.ndarray) -> np.ndarray:
    """Inputs (3,) of the speed network as a trace row gives them, with the true grade for the estimated one."""
    p = control.longitudinal
    if not p.feedforward:
        return row[[AT.path_position, AT.speed_long, AT.accel_long]]
    speed, accel, grade = row[_SPEED].tolist()
    return np.array((p.speed_scale * speed, p.accel_scale * accel, p.grade_scale * GRAVITY * math.sin(grade)))


def style_insights(stream: Stream) -> None:
    """What never changes about the views of the networks."""
    for network in COLORS:
        shape = rr.Ellipsoids3D.from_fields(fill_mode="MajorWireframe", line_radii=rr.Radius.ui_points(1.2))
        stream.static(f"/networks/{network}/centers", shape)
        stream.static(f"/plots/{network}_network", rr.SeriesLines.from_fields(widths=LINE_WIDTH))


def send_insights(stream: Stream, network: str, times: np.ndarray, seen: list[Insight]) -> None:
    """Send one network at `times` (n,) [ms]: spheres about the centers, the last one where the car is, and the plotted
    numbers."""
    weights, widths = (np.concatenate([getattr(one, name) for one in seen]) for name in ("weights", "widths"))
    counts = np.array([len(one.widths) for one in seen])
    neurons = np.ones(counts.sum() + len(seen), dtype=bool)
    neurons[np.cumsum(counts + 1) - 1] = False  # the car
    centers = np.concatenate([np.vstack((one.centers, one.point))[:, :3] for one in seen], dtype=np.float32)
    radii = np.empty((len(neurons), 1), dtype=np.float32)
    radii[neurons, 0], radii[~neurons, 0] = DRAWN * widths, [_point_size(one) for one in seen]
    colors = np.full(len(neurons), _CAR, dtype=np.uint32)
    colors[neurons] = np.where(weights >= 0.0, _POSITIVE, _NEGATIVE)
    spheres = rr.Ellipsoids3D.columns(centers=centers, half_sizes=np.repeat(radii, 3, axis=1), colors=colors)
    stream.send(f"/networks/{network}/centers", times, spheres.partition(counts + 1))
    columns = [
        _column("weights", _padded(weights, counts)),
        _column("widths", _padded(widths, counts)),
        _column("covariance", np.array([one.covariance for one in seen])),
        _column("share_learned", np.array([100.0 * one.share for one in seen])),
    ]
    stream.send(f"/plots/{network}_network", times, columns)


def _point_size(one: Insight) -> float:
    """Radius of the sphere that is the car: half of an average neuron's."""
    return 0.5 * DRAWN * float(one.widths.mean()) if len(one.widths) else DRAWN


def _padded(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """(n, SHOWN) the first of each row's `counts` values, 0 where there are none: the viewer wants as many in each."""
    place = np.arange(len(values)) - np.repeat(np.cumsum(counts) - counts, counts)
    row = np.repeat(np.arange(len(counts)), counts)
    found = np.zeros((len(counts), SHOWN))
    few = place < SHOWN
    found[row[few], place[few]] = values[few]
    return found


def _column(name: str, values: np.ndarray) -> rr.ComponentColumn:
    return series(rr.ComponentDescriptor(f"{ARCHETYPE}:{name}"), values)
