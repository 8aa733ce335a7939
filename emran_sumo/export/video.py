"""A run as a video: the view from above that follows the ego, and key plots with a moving cursor."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from emran_sumo.export.encoder import encode
from emran_sumo.export.sheet import PANELS, VERMILION, draw_panel
from emran_sumo.print_style import STYLE
from emran_sumo.recording.playback import Scene
from emran_sumo.warm import Progress

SIZE = (1280, 720)  # pixels
RATE = 20  # frames per second, in real time
TRAIL = 10.0  # s
_DOTS = 100
_SHOWN_ROAD = (-45.0, 75.0, -17.0, 17.0)  # m behind and ahead of the ego, to its right and left
_SHOWN = ("cross-track error (m)", "speed (m/s)", "steering angle (deg)", "neurons")
_ASPHALT, _PAINT, _TRAFFIC = "#4b5059", "#f2f2f2", "#a9b4c4"
_NEAR = 90.0  # m around the ego in which the road is drawn


def draw_video(
    file: Path,
    encoder: str,
    trace: Mapping[str, np.ndarray],
    scene: Scene,
    summary: Mapping[str, Any],
    progress: Progress = lambda *_: None,
) -> None:
    """Write the video as MP4.

    Args:
        file: to write; encoder: an ffmpeg.
        trace: (n,) columns by name; scene: from `read_scene`; summary: of the run.
        progress: called with ("draw", seconds drawn, seconds in all).
    """
    with mpl.rc_context({**STYLE, "font.size": 9.0, "axes.titlesize": 9.5, "figure.constrained_layout.use": False}):
        picture = _Picture(trace, scene, summary)
        encode(file, encoder, picture.frames(progress), SIZE, RATE)


class _Picture:
    """The figure: drawn once, then only what moves is drawn again."""

    def __init__(self, trace: Mapping[str, np.ndarray], scene: Scene, summary: Mapping[str, Any]) -> None:
        self._trace, self._scene, self._outline = trace, scene, summary["outline"]
        self._milliseconds = np.rint(trace["time"] * 1e3).astype(np.int64)
        self._middles = scene.triangles.mean(axis=1)
        self._ends = np.array([(line[0] + line[-1]) / 2 for line in scene.lines]).reshape(-1, 2)
        self._reaches = np.array([np.ptp(line, axis=0).max() / 2 for line in scene.lines])
        self._sizes = np.ptp(scene.triangles, axis=1).max(axis=1)
        figure = Figure(figsize=(SIZE[0] / _DOTS, SIZE[1] / _DOTS), dpi=_DOTS, facecolor="white")
        self._canvas = FigureCanvasAgg(figure)
        manifest = summary["manifest"]
        values = manifest["scenario"]
        title = f"{manifest['scenario_name']},  {values['controller']},  seed {values['seed']}"
        figure.text(0.02, 0.955, title, fontsize=13, weight="bold")
        view = figure.add_axes((0.02, 0.45, 0.96, 0.484))
        self._moving = self._draw_view(view) + self._draw_plots(figure)
        self._clock = figure.text(0.98, 0.955, "", fontsize=13, ha="right", animated=True)
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(figure.bbox)

    def frames(self, progress: Progress) -> Iterator[bytes]:
        """Pictures in RGB at RATE per second of the run."""
        first, end, period = int(self._milliseconds[0]), int(self._milliseconds[-1]), 1000 // RATE
        for now in range(-(-first // period) * period, end + 1, period):  # the instants of the traffic
            k = int(np.searchsorted(self._milliseconds, now))
            self._move(k, now)
            self._canvas.restore_region(self._still)
            for axes, artist in self._moving:
                axes.draw_artist(artist)
            self._clock.set_text(f"{now / 1000:.1f} s    {self._trace['speed_long'][k]:.1f} m/s")
            self._canvas.figure.draw_artist(self._clock)
            yield np.asarray(self._canvas.buffer_rgba())[:, :, :3].tobytes()
            progress("draw", now / 1000, end / 1000)

    def _draw_view(self, view: Axes) -> list[tuple[Axes, Artist]]:
        view.set(xlim=_SHOWN_ROAD[:2], ylim=_SHOWN_ROAD[2:], xticks=[], yticks=[])
        view.set_aspect("equal", adjustable="box")
        view.spines[:].set_visible(False)
        view.set_facecolor("#dfe5dc")
        view.grid(visible=False)
        self._asphalt = PolyCollection([], facecolors=_ASPHALT, edgecolors=_ASPHALT, linewidths=0.6)
        self._paint = LineCollection([], colors=_PAINT, linewidths=1.3)
        self._trail = LineCollection([], colors=VERMILION, linewidths=1.6, alpha=0.8)
        self._others = PolyCollection([], facecolors=_TRAFFIC, edgecolors="#2b2f36", linewidths=0.7)
        self._ego = PolyCollection([], facecolors=[VERMILION, "white"], edgecolors="#2b2f36", linewidths=0.7)
        parts = (self._asphalt, self._paint, self._trail, self._others, self._ego)
        for part in parts:
            part.set_animated(True)
            view.add_collection(part, autolim=False)
        return [(view, part) for part in parts]

    def _draw_plots(self, figure: Figure) -> list[tuple[Axes, Artist]]:
        panels = [panel for panel in PANELS if panel.title in _SHOWN]
        self._cursors = []
        for i, panel in enumerate(panels):
            axes = figure.add_axes((0.05 + 0.5 * (i % 2), 0.265 - 0.205 * (i // 2), 0.43, 0.135))
            draw_panel(axes, panel, self._trace, legend_above=True)
            if i < 2:
                axes.tick_params(labelbottom=False)
            self._cursors.append(axes.axvline(0.0, color="black", linewidth=1.2, animated=True))
        return [(cursor.axes, cursor) for cursor in self._cursors]

    def _move(self, k: int, now: int) -> None:
        trace = self._trace
        here, turn = np.array([trace["x"][k], trace["y"][k]]), -trace["reference_yaw"][k]
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

        def seen(points: np.ndarray) -> np.ndarray:
            return (points - here) @ rotation.T

        near = np.abs(self._middles - here).max(axis=1) < _NEAR + self._sizes
        self._asphalt.set_verts(list(seen(self._scene.triangles[near])))
        close = np.flatnonzero(np.abs(self._ends - here).max(axis=1) < _NEAR + self._reaches)
        self._paint.set_segments([seen(self._scene.lines[i]) for i in close])
        past = slice(int(np.searchsorted(self._milliseconds, now - 1000 * TRAIL)), k + 1, 5)
        self._trail.set_segments([seen(np.column_stack((trace["x"][past], trace["y"][past])))])
        self._others.set_verts([seen(corners) for corners in self._boxes_at(now)])
        self._ego.set_verts([seen(part) for part in self._car(here, float(trace["yaw"][k]))])
        for cursor in self._cursors:
            cursor.set_xdata([now / 1000] * 2)

    def _boxes_at(self, now: int) -> np.ndarray:
        i = int(np.searchsorted(self._scene.times, now, side="right")) - 1
        if i < 0:
            return np.zeros((0, 4, 2))
        x, y, yaw, length, width = self._scene.traffic[i].T
        return _boxes(x, y, yaw, length, width)

    def _car(self, here: np.ndarray, yaw: float) -> list[np.ndarray]:
        """Body and an arrow ahead on its roof."""
        length, width, ahead = (self._outline[key] for key in ("length", "width", "ahead"))
        along, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
        middle = here + ahead * along
        body = _boxes(*(np.array([v]) for v in (middle[0], middle[1], yaw, length, width)))[0]
        arrow = [middle + 0.35 * length * along, middle + 0.3 * width * left, middle - 0.3 * width * left]
        return [body, np.array(arrow)]


def _boxes(x: np.ndarray, y: np.ndarray, yaw: np.ndarray, length: np.ndarray, width: np.ndarray) -> np.ndarray:
    """(n, 4, 2) corners of oriented rectangles."""
    along = np.stack((np.cos(yaw), np.sin(yaw)), axis=-1) * length[:, None] / 2
    left = np.stack((-np.sin(yaw), np.cos(yaw)), axis=-1) * width[:, None] / 2
    middle = np.stack((x, y), axis=-1)
    return np.stack(
        (middle + along + left, middle + along - left, middle - along - left, middle - along + left), axis=1
    )
