"""The tire forces of a vehicle as a picture."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from emran_sumo.errors import UserError
from emran_sumo.plant.records import VehicleParams
from emran_sumo.vehicles import (
    SLIP_ANGLES,
    SLIP_RATIOS,
    axle_loads,
    axle_stiffness,
    lateral_forces,
    longitudinal_forces,
)

# told apart by color-blind readers, and by their dashes in print
AXLES = (("front axle", "#0072B2", "-"), ("rear axle", "#D55E00", "--"))
FRICTIONS = ((1.0, 2.2), (0.5, 1.2))  # and width of its line


def draw(vehicle: VehicleParams, name: str, file: Path) -> None:
    """Lateral force over slip angle and longitudinal force over slip ratio, of both axles at their static loads.

    Raises:
        UserError: the file cannot be written.
    """
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for (axle, color, dashes), load, stiffness in zip(AXLES, axle_loads(vehicle), axle_stiffness(vehicle), strict=True):
        for friction, width in FRICTIONS:
            style = {"color": color, "linestyle": dashes, "linewidth": width, "label": f"{axle}, friction {friction:g}"}
            lateral = lateral_forces(vehicle, stiffness, load, friction)
            left.plot(np.degrees(SLIP_ANGLES), lateral / 1e3, **style)
            right.plot(100.0 * SLIP_RATIOS, longitudinal_forces(vehicle, stiffness, load, friction) / 1e3, **style)
    left.set(xlabel="slip angle (deg)", ylabel="lateral force (kN)", title=f"{name}: cornering")
    right.set(xlabel="slip ratio (%)", ylabel="longitudinal force (kN)", title=f"{name}: driving")
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.set(xlim=(0, None), ylim=(0, None))
        axes.spines[["top", "right"]].set_visible(False)
    left.legend(frameon=False, fontsize="small")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(file, dpi=150)
    except (OSError, ValueError) as error:
        raise UserError(f"--out: cannot write {file}: {error}; accepted is a PNG, SVG or PDF file.") from None
