"""What stands beside the road surface: stop lines, lights, and stretches with another friction."""

from typing import NamedTuple

import numpy as np
import rerun as rr

from emran_sumo.path import Path
from emran_sumo.plant.disturbance import DisturbanceParams
from emran_sumo.recording.colors import LABEL, PAINT, SIGNAL_COLORS, SLIPPERY, packed
from emran_sumo.recording.road import ASPHALT_LEVEL, LINE_LEVEL, offset, ribbon
from emran_sumo.recording.stream import Stream
from emran_sumo.world.records import StopLine

LAMP_HEIGHT = 4.5  # m
WORD_PERIOD, WORD_AWAY = (
    80.0,
    4.0,
)  # m between the words about a stretch, of which one or two are in sight; from its edge
PATCH_LEVEL = ASPHALT_LEVEL + 0.03  # m: on the asphalt, below the paint


class Patch(NamedTuple):
    """A stretch of the road with another friction: center line (n, 2) [m], width [m], factor on the road's friction."""

    line: np.ndarray
    width: float
    friction: float


def patch_on(disturbance: DisturbanceParams, path: Path, width: float, origin: float = 0.0) -> Patch | None:
    """The stretch that a disturbance declares along a path that begins at `origin` [m] of the road, `width` [m] wide;
    None where there is none."""
    d = disturbance
    ends = (d.patch_start - origin, d.patch_end - origin)
    first, last = (int(min(max(at, 0.0) / path.spacing, path.x.size - 1)) for at in ends)
    if last <= first or d.patch_friction == 1.0:
        return None
    every = max(int(2.0 / path.spacing), 1)
    line = np.column_stack((path.x[first : last + 1 : every], path.y[first : last + 1 : every]))
    return Patch(line, width, d.patch_friction) if len(line) > 1 else None


def draw_stop_lines(stream: Stream, lines: tuple[StopLine, ...]) -> None:
    """Log the lines once; those of lights, and a lamp above each, get their colors from `signal_colors`."""
    plain = [_raised(line.ends) for line in lines if not line.light]
    if plain:
        stream.static("/world/road/stop_lines", rr.LineStrips3D(plain, radii=0.18, colors=packed([PAINT])))
    lit = [_raised(line.ends) for line in lines if line.light]
    if lit:
        stream.static("/world/signals/lines", rr.LineStrips3D(lit, radii=0.25))
        lamps = [ends.mean(axis=0) + np.array((0.0, 0.0, LAMP_HEIGHT)) for ends in lit]
        stream.static("/world/signals/lamps", rr.Points3D(lamps, radii=0.4))


def signal_colors(states: str) -> np.ndarray:
    """(n,) packed colors of SUMO's letters for the lights, one per stop line."""
    return packed(SIGNAL_COLORS.get(letter, SIGNAL_COLORS["O"]) for letter in states)


def send_signals(stream: Stream, changes: list[tuple[int, str]]) -> None:
    """Send what the lights show from each time [ms] on."""
    if not changes:
        return
    times, states = zip(*changes, strict=True)
    colors = signal_colors("".join(states))
    lengths = [len(letters) for letters in states]
    lines = rr.LineStrips3D.columns(colors=colors).partition(lengths)
    stream.send("/world/signals/lines", np.array(times), lines)
    stream.send("/world/signals/lamps", np.array(times), rr.Points3D.columns(colors=colors).partition(lengths))


class PatchSender:
    """Draws the stretch as a tinted surface with words beside it, anew when it is on another lane."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._drawn: Patch | None = None

    def send(self, time: int, patch: Patch | None) -> None:
        """Draw it from `time` [ms] on; None takes away what was drawn."""
        if patch is not None:
            if self._drawn is None:
                word = rr.Points3D.from_fields(radii=rr.Radius.ui_points(0.1), colors=packed([LABEL]), show_labels=True)
                self._stream.static("/world/road/patch/label", word)
                surface = rr.Mesh3D.from_fields(albedo_factor=int(packed([SLIPPERY])[0]))
                self._stream.static("/world/road/patch", surface)
            left, right = offset(patch.line, 0.5 * patch.width), offset(patch.line, -0.5 * patch.width)
            flat = np.concatenate((left, right))
            vertices, triangles = np.column_stack((flat, np.full(len(flat), PATCH_LEVEL))), ribbon(len(left))
            places = _beside(patch)
            words = [f"friction × {patch.friction:g}"] * len(places)
        elif self._drawn is not None:
            vertices, triangles, places = (np.zeros((0, 3)) for _ in range(3))
            words = []
        else:
            return
        self._drawn = patch
        normals = np.broadcast_to(np.array([0.0, 0.0, 1.0], dtype=np.float32), vertices.shape)
        surface = (
            *rr.Mesh3D.columns(vertex_positions=vertices, vertex_normals=normals).partition([len(vertices)]),
            *rr.Mesh3D.columns(triangle_indices=triangles.astype(np.uint32)).partition([len(triangles)]),
        )
        self._stream.send("/world/road/patch", np.array([time]), surface)
        mark = rr.Points3D.columns(positions=places, labels=words).partition([len(places)])
        self._stream.send("/world/road/patch/label", np.array([time]), mark)


def _beside(patch: Patch) -> np.ndarray:
    """(n, 3) places for a word, at the right of the stretch: at its begin and every WORD_PERIOD after."""
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(patch.line, axis=0).T))))
    chosen = np.searchsorted(along, np.arange(0.0, along[-1], WORD_PERIOD))
    at = offset(patch.line, -0.5 * patch.width - WORD_AWAY)[chosen]
    return np.column_stack((at, np.full(len(at), 0.1)))


def _raised(ends: np.ndarray) -> np.ndarray:
    return np.column_stack((ends, np.full(len(ends), LINE_LEVEL)))
