"""The ego as it is drawn: body, wheels and heading, once per file; the recorder moves them."""

from typing import NamedTuple

import rerun as rr

from emran_sumo.recording.colors import GLASS, LABEL, PAINT, PINK, RED, RUBBER, packed
from emran_sumo.recording.stream import Stream


class EgoShape(NamedTuple):
    """Outline of the ego [m]; front_axle: ahead of the center of gravity, front_overhang: ahead of that."""

    length: float
    width: float
    height: float
    wheelbase: float
    front_axle: float
    front_overhang: float


def draw_ego(stream: Stream, ego: EgoShape) -> None:
    """Log the parts once, under /world/ego."""
    middle = ego.front_axle + ego.front_overhang - ego.length / 2
    cabin = middle - 0.06 * ego.length
    stream.static("/world/ego/body", _body(ego, middle, cabin))
    stream.static("/world/ego/heading", _arrow(ego, cabin))
    for axle, x in (("front_wheels", ego.front_axle), ("rear_wheels", ego.front_axle - ego.wheelbase)):
        stream.static(f"/world/ego/{axle}", _wheels(x, ego.width / 2 - 0.1))
    stream.static("/world/ego/brake_lights", _brake_lights(ego, middle))
    stream.static("/world/ego/side_force", rr.Arrows3D.from_fields(radii=0.25, colors=packed([RED])))
    word = rr.Points3D.from_fields(radii=rr.Radius.ui_points(0.1), colors=packed([LABEL]), show_labels=True)
    for entity in ("side_force/label", "grade"):
        stream.static(f"/world/ego/{entity}", word)
    marker = rr.Points3D([(0, 0, 0)], radii=rr.Radius.ui_points(6), colors=packed([PINK]))
    stream.static("/world/ego/marker", marker)


def _body(ego: EgoShape, middle: float, cabin: float) -> rr.Boxes3D:
    belt, roof = 0.62 * ego.height, ego.height
    return rr.Boxes3D(
        centers=[(middle, 0, (0.25 + belt) / 2), (cabin, 0, (belt + roof) / 2)],
        half_sizes=[
            (ego.length / 2, ego.width / 2 - 0.06, (belt - 0.25) / 2),
            (0.27 * ego.length, 0.42 * ego.width, (roof - belt) / 2),
        ],
        colors=packed([PINK, GLASS]),
        fill_mode="solid",
    )


def _brake_lights(ego: EgoShape, middle: float) -> rr.Boxes3D:
    """Two at the corners of the rear, high enough to be seen from above too; the motion brings their color."""
    rear, side = middle - 0.5 * ego.length + 0.17, 0.29 * ego.width
    return rr.Boxes3D(
        centers=[(rear, side, 0.5 * ego.height), (rear, -side, 0.5 * ego.height)],
        half_sizes=[(0.2, 0.18 * ego.width, 0.14 * ego.height)],
        fill_mode="solid",
    )


def _arrow(ego: EgoShape, cabin: float) -> rr.Mesh3D:
    """A triangle on the roof that points ahead."""
    tip, side, level = 0.16 * ego.length, 0.3 * ego.width, ego.height + 0.03
    return rr.Mesh3D(
        vertex_positions=[(cabin + tip, 0, level), (cabin - tip, side, level), (cabin - tip, -side, level)],
        triangle_indices=[[0, 1, 2]],
        vertex_normals=[(0, 0, 1)] * 3,
        albedo_factor=int(packed([PAINT])[0]),
    )


def _wheels(x: float, y: float) -> rr.Boxes3D:
    return rr.Boxes3D(
        centers=[(x, y, 0.33), (x, -y, 0.33)],
        half_sizes=[(0.33, 0.12, 0.33)],
        colors=packed([RUBBER]),
        fill_mode="solid",
    )
