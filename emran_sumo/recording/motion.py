"""The ego as it moves: pose, wheels, trail, brake lights, side force, and the forces of its tires."""

from collections.abc import Callable

import numpy as np
import rerun as rr

from emran_sumo.recording.car import EgoShape
from emran_sumo.recording.colors import AMBER, BLUE, BRAKE_OFF, BRAKE_ON, LABEL, PINK, RED, SLATE, packed
from emran_sumo.recording.stream import Changes, Stream, turns

BRAKING = -100.0  # N m of wheel torque below which the brake lights shine
FORCE_STEP = 100.0  # N: finer changes of a side force are not drawn
FORCE_SCALE = 1.5e-3  # m of arrow per N
GRADE_STEP, GRADE_PLACE = 0.5, (9.0, -7.0, 0.1)  # %: finer changes are not told; m, ahead of the ego on its right
LOAD_STEP = 0.05  # kN
TIRES_APART = 20.0  # kN between the middles of the front and the rear axle in their view
AXLES = (("front", -0.5 * TIRES_APART, BLUE), ("rear", 0.5 * TIRES_APART, AMBER))
# what is read of a row
POSE = ("x", "y", "yaw", "reference_yaw", "steer", "torque", "force_external_lat", "friction", "grade")
TIRE = ("force_long_{}", "force_lat_{}", "load_{}")


class EgoMotion:
    """Sends what moves with the ego; `index` gives the place of a trace column."""

    def __init__(self, stream: Stream, shape: EgoShape, index: Callable[[str], int]) -> None:
        self._stream, self._shape = stream, shape
        self._columns = [index(name) for name in POSE]
        self._tires = {axle: [index(name.format(axle)) for name in TIRE] for axle, *_ in AXLES}
        self._last_point: np.ndarray | None = None
        self._brakes, self._force, self._grade = Changes(), Changes(), Changes()
        self._limits = {axle: Changes() for axle, *_ in AXLES}
        stream.static("/world/trail", rr.LineStrips3D.from_fields(radii=0.14, colors=packed([PINK])))
        _draw_tires(stream)

    def send(self, times: np.ndarray, rows: np.ndarray) -> None:
        """Send the rows (n, columns) at `times` (n,) [ms]."""
        x, y, yaw, road_yaw, steer, torque, force, friction, grade = rows[:, self._columns].T
        points = np.column_stack((x, y, np.zeros_like(x))).astype(np.float32)
        for entity, angle in (("/world/ego", yaw), ("/world/ego_frame", road_yaw)):
            self._stream.send(entity, times, rr.Transform3D.columns(translation=points, quaternion=turns(angle)))
        columns = rr.Boxes3D.columns(quaternions=np.repeat(turns(steer), 2, axis=0))
        self._stream.send("/world/ego/front_wheels", times, columns.partition([2] * len(times)))
        self._send_trail(times, points)
        self._send_brakes(times, torque)
        self._send_force(times, force)
        self._send_grade(times, grade)
        self._send_tires(times, rows, friction)

    def _send_trail(self, times: np.ndarray, points: np.ndarray) -> None:
        """One segment per step, from where the ego was a step before."""
        start = points[:1] if self._last_point is None else self._last_point
        joined = np.concatenate((start, points)) + np.array([0.0, 0.0, 0.05], dtype=np.float32)
        self._last_point = points[-1:]
        strips = np.stack((joined[:-1], joined[1:]), axis=1)
        self._stream.send("/world/trail", times, rr.LineStrips3D.columns(strips=strips))

    def _send_brakes(self, times: np.ndarray, torque: np.ndarray) -> None:
        on = torque < BRAKING
        new = self._brakes(on.astype(int))
        colors = packed(BRAKE_ON if braking else BRAKE_OFF for braking in on[new])
        self._stream.send("/world/ego/brake_lights", times[new], rr.Boxes3D.columns(colors=colors))

    def _send_force(self, times: np.ndarray, force: np.ndarray) -> None:
        """An arrow that ends at the side of the car it pushes; none without a force."""
        rounded = np.rint(force / FORCE_STEP) * FORCE_STEP
        new = self._force(rounded)
        acting = rounded[new]
        pushed = acting[acting != 0.0]
        flat = np.zeros((len(pushed), 3), dtype=np.float32)
        vectors, origins = flat.copy(), flat
        vectors[:, 1] = FORCE_SCALE * pushed
        origins[:, 1] = -vectors[:, 1] - np.sign(pushed) * 0.5 * self._shape.width
        origins[:, 2] = 0.7 * self._shape.height
        counts = (acting != 0.0).astype(int)
        columns = rr.Arrows3D.columns(vectors=vectors, origins=origins)
        self._stream.send("/world/ego/side_force", times[new], columns.partition(counts))
        words = rr.Points3D.columns(positions=origins, labels=[f"{abs(f) / 1e3:.1f} kN" for f in pushed])
        self._stream.send("/world/ego/side_force/label", times[new], words.partition(counts))

    def _send_grade(self, times: np.ndarray, grade: np.ndarray) -> None:
        """A word beside the ego where the road climbs or falls."""
        percent = np.rint(100.0 * np.tan(grade) / GRADE_STEP) * GRADE_STEP
        new = self._grade(percent)
        steep = percent[new][percent[new] != 0.0]
        words = [f"{'uphill' if p > 0.0 else 'downhill'} {abs(p):.1f} %" for p in steep]
        columns = rr.Points3D.columns(positions=np.tile(GRADE_PLACE, (len(steep), 1)), labels=words)
        self._stream.send("/world/ego/grade", times[new], columns.partition((percent[new] != 0.0).astype(int)))

    def _send_tires(self, times: np.ndarray, rows: np.ndarray, friction: np.ndarray) -> None:
        """One arrow per axle, left is left and ahead is up; and circles that grow with the load."""
        vectors = []
        for axle, middle, _ in AXLES:
            long, lat, load = rows[:, self._tires[axle]].T / 1e3
            vectors.append(np.column_stack((-lat, -long)))
            limit = np.rint(np.maximum(friction * load, 0.0) / LOAD_STEP) * LOAD_STEP
            new = self._limits[axle](limit)
            radius = np.maximum(limit[new], LOAD_STEP).astype(np.float32)
            places = np.tile(np.array([middle, 0.0, 0.0], dtype=np.float32), (len(radius), 1))
            scale = np.column_stack((radius, radius, np.ones_like(radius)))
            columns = rr.Transform3D.columns(translation=places, scale=scale)
            self._stream.send(f"/tires/{axle}/limit", times[new], columns)
        both = np.stack(vectors, axis=1).reshape(-1, 2).astype(np.float32)
        self._stream.send(
            "/tires/forces", times, rr.Arrows2D.columns(vectors=both).partition([len(AXLES)] * len(times))
        )


def _draw_tires(stream: Stream) -> None:
    """Circles of radius 1, scaled to friction times load while driving, and the axes of the car in each."""
    angle = np.linspace(0.0, 2.0 * np.pi, 65)
    circle = np.column_stack((np.cos(angle), np.sin(angle)))
    arrows = rr.Arrows2D.from_fields(
        origins=[(middle, 0.0) for _, middle, _ in AXLES],
        radii=rr.Radius.ui_points(2.5),
        colors=packed(color for *_, color in AXLES),
    )
    stream.static("/tires/forces", arrows)
    for axle, middle, _ in AXLES:
        limit = rr.LineStrips2D([circle], radii=rr.Radius.ui_points(1.5), colors=packed([RED]))
        stream.static(f"/tires/{axle}/limit", limit)
        axes = [[(middle - 9, 0), (middle + 9, 0)], [(middle, -9), (middle, 9)]]
        stream.static(
            f"/tires/{axle}/axes", rr.LineStrips2D(axes, radii=rr.Radius.ui_points(0.5), colors=packed([SLATE]))
        )
        name = rr.Points2D(
            [(middle, -12.8)], radii=rr.Radius.ui_points(0.1), colors=packed([LABEL]), labels=f"{axle} axle",
            show_labels=True,
        )  # fmt: skip
        stream.static(f"/tires/{axle}/name", name)
